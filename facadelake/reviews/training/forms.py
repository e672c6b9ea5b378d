"""What a training set is made of, as a person chooses it; no library is needed to know the words."""

from __future__ import annotations

from enum import StrEnum


class TrainingLabelFormat(StrEnum):
    """How labels are written."""

    COCO = "coco"
    YOLO = "yolo"


class PictureMode(StrEnum):
    """What the set's pictures are: tiles about reviewed places, or whole photographs, copied or linked."""

    TILES = "tiles"
    COPY = "copy"
    LINK = "link"
