"""One picture with its boxes, whatever set it comes from."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.core.errors import FacadelakeError
from schemas.vocabulary import DefectClass

CLASSES: tuple[DefectClass, ...] = (DefectClass.CRACK, DefectClass.SPALLING, DefectClass.MOISTURE)
"""Class index -> defect class, in the trained model's order."""


class Split(StrEnum):
    """What a site is used for; a site has one split, so no wall is both learned from and judged by."""

    TRAIN = "train"
    VAL = "val"
    TEST = "test"


@dataclass(frozen=True, kw_only=True)
class Sample:
    """A picture on disk and the boxes drawn in it.

    `boxes_px` is (N, 4) x_min, y_min, x_max, y_max in pixels, (0, 0) the outer corner of the first pixel; `classes`
    (N,) indexes `CLASSES`. No boxes: the picture is free of defects. `site` is `set/site`.
    """

    path: Path
    boxes_px: NDArray[np.float64]
    classes: NDArray[np.int64]
    site: str
    split: Split

    def __post_init__(self) -> None:
        if self.boxes_px.shape != (len(self.classes), 4):
            raise FacadelakeError(
                f"{self.path}: boxes {self.boxes_px.shape} and {len(self.classes)} classes; they must be (N, 4), (N,)"
            )

    def read(self) -> NDArray[np.uint8]:
        """The picture, BGR, not turned by EXIF: nor are boxes. Raises FacadelakeError when it cannot be read."""
        image = cv2.imread(str(self.path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if image is None:
            raise FacadelakeError(
                f"{self.path}: no picture can be read there; put the set back as its PROVENANCE.txt says"
            )
        return np.asarray(image, dtype=np.uint8)
