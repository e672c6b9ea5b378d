"""What a person chooses of a training set: the label format, the pictures and the split of each building."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from enum import StrEnum

from facadelake.core.errors import InputDataError


class TrainingLabelFormat(StrEnum):
    """The format of the label files."""

    COCO = "coco"
    YOLO = "yolo"


class PictureMode(StrEnum):
    """The set's pictures: tiles around the reviewed locations, or whole photographs, copied or linked."""

    TILES = "tiles"
    COPY = "copy"
    LINK = "link"


VAL_SHARE, TEST_SHARE = 0.15, 0.15  # expected shares of buildings


class Split(StrEnum):
    """What a building's photographs are used for."""

    TRAIN = "train"
    VAL = "val"
    TEST = "test"


def choose_split(building_id: str, chosen: Mapping[str, Split]) -> Split:
    """The building's split: as ``chosen``, else by the hash of its id. Further buildings do not change it."""
    if building_id in chosen:
        return chosen[building_id]
    position = int.from_bytes(hashlib.sha256(building_id.encode()).digest()[:8], "big") / 2**64
    if position < TEST_SHARE:
        return Split.TEST
    return Split.VAL if position < TEST_SHARE + VAL_SHARE else Split.TRAIN


def parse_splits(texts: tuple[str, ...]) -> dict[str, Split]:
    """Splits by building from texts such as ``castle=test``. Raises InputDataError for another form or two splits of a
    building."""
    chosen: dict[str, Split] = {}
    for text in texts:
        building, equals, name = text.partition("=")
        if not equals or not building or name not in set(Split):
            raise InputDataError(f"--split '{text}' is not BUILDING=SPLIT with a split of {', '.join(Split)}")
        if chosen.get(building, name) != name:
            raise InputDataError(f"--split assigns '{building}' to {chosen[building]} and {name}; choose one")
        chosen[building] = Split(name)
    return chosen
