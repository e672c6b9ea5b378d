"""How labels are written. Apart from their readers, because the command line knows it before it needs them."""

from __future__ import annotations

from enum import StrEnum


class LabelFormat(StrEnum):
    """A format of labels; ``auto`` is found out by what lies there."""

    AUTO = "auto"
    COCO = "coco"
    YOLO = "yolo"
    VOC = "voc"
