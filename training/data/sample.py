"""A picture with its boxes, of any set."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facadelake.core.arrays import Float64Nx4, Int64Array, UInt8Image
from facadelake.core.errors import FacadelakeError
from facadelake.reviews.training import Split
from schemas.vocabulary import DefectClass

CLASSES: tuple[DefectClass, ...] = (DefectClass.CRACK, DefectClass.SPALLING, DefectClass.MOISTURE)
"""Defect classes by class index of the trained model."""


@dataclass(frozen=True, kw_only=True)
class Sample:
    """A picture file with its boxes, site and split; a site has one split, so that no wall is in two splits.

    `boxes_px`: (n, 4) x_min, y_min, x_max, y_max in pixels, with (0, 0) at the outer corner of the first pixel.
    `classes`: (n,) indices in `CLASSES`. A picture without boxes is free of defects. `site`: `set/site`.
    """

    path: Path
    boxes_px: Float64Nx4
    classes: Int64Array
    site: str
    split: Split

    def __post_init__(self) -> None:
        if self.boxes_px.shape != (len(self.classes), 4):
            raise FacadelakeError(
                f"{self.path}: boxes {self.boxes_px.shape} and {len(self.classes)} classes; they must be (n, 4), (n,)"
            )

    def read(self) -> UInt8Image:
        """The picture (h, w, 3: blue, green, red); its EXIF orientation is not applied, as the boxes refer to the file.

        Raises FacadelakeError if it cannot be read.
        """
        image = cv2.imread(str(self.path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if image is None:
            raise FacadelakeError(
                f"{self.path}: no picture can be read there; restore the set as described in its PROVENANCE.txt"
            )
        return np.asarray(image, dtype=np.uint8)
