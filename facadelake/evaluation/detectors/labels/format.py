"""Formats of labels. A module of its own: the command line imports it without the readers."""

from __future__ import annotations

from enum import StrEnum


class LabelFormat(StrEnum):
    """A format of labels; ``auto``: detected by the files."""

    AUTO = "auto"
    COCO = "coco"
    YOLO = "yolo"
    VOC = "voc"
