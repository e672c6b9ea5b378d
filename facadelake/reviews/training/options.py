"""What a person chooses of a training set: the label format, the pictures and the split of each building."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from enum import StrEnum

from facadelake.core.errors import InputDataError


class TrainingLabelFormat(StrEnum):
    """How labels are written."""

    COCO = "coco"
    YOLO = "yolo"


class PictureMode(StrEnum):
    """What the set's pictures are: tiles about reviewed places, or whole photographs, copied or linked."""

    TILES = "tiles"
    COPY = "copy"
    LINK = "link"


VAL_SHARE, TEST_SHARE = 0.15, 0.15  # of all buildings there may ever be


class Split(StrEnum):
    """What a building's photographs are used for."""

    TRAIN = "train"
    VAL = "val"
    TEST = "test"


def choose_split(building_id: str, chosen: Mapping[str, Split]) -> Split:
    """The building's split: the one ``chosen``, else by the hash of its id, which never changes as buildings join."""
    if building_id in chosen:
        return chosen[building_id]
    place = int.from_bytes(hashlib.sha256(building_id.encode()).digest()[:8], "big") / 2**64
    if place < TEST_SHARE:
        return Split.TEST
    return Split.VAL if place < TEST_SHARE + VAL_SHARE else Split.TRAIN


def parse_splits(words: tuple[str, ...]) -> dict[str, Split]:
    """``castle=test`` and the like as splits by building. Raises InputDataError for anything else."""
    chosen: dict[str, Split] = {}
    for word in words:
        building, equals, name = word.partition("=")
        if not equals or not building or name not in set(Split):
            raise InputDataError(f"--split '{word}' is not BUILDING=SPLIT with a split of {', '.join(Split)}")
        if chosen.get(building, name) != name:
            raise InputDataError(f"--split puts '{building}' into {chosen[building]} and {name}; choose one")
        chosen[building] = Split(name)
    return chosen
