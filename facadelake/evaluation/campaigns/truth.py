"""The truth folder: published cameras, check points, and the check point that each annotation shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from facadelake.core.arrays import Float64x3
from facadelake.core.errors import InputDataError
from facadelake.evaluation.truth_tables import CsvRow, read_truth_rows

OFF_TARGET = "off_target"
_GEO = ("lon_deg", "lat_deg", "height_ellipsoidal_m")


@dataclass(frozen=True, kw_only=True, eq=False)
class CheckPoint:
    """A point measured independently of the run; ``geo`` (3,): longitude, latitude, deg, ellipsoidal height, m
    (EPSG:4979)."""

    geo: Float64x3
    element_guid: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """Content of a truth folder.

    ``cameras``: centre (3,) by photograph, EPSG:4979. ``check_point_of_annotation``: by (file, annotation id); None for
    a false detection.
    """

    cameras: Mapping[str, Float64x3]
    checkpoints: Mapping[str, CheckPoint]
    check_point_of_annotation: Mapping[tuple[str, str], str | None]


def read_truth(folder: Path) -> Truth:
    """Read ``cameras.csv``, ``checkpoints.csv`` and ``detections.csv`` of a truth folder.

    Positions are read from the EPSG:4979 columns alone: the site origin of a run may differ from that of truth.
    Raises InputDataError where a file is missing or invalid.
    """
    cameras = {
        row["image"]: _parse_position(row) for row in read_truth_rows(folder / "cameras.csv", "image", "image", *_GEO)
    }
    checkpoints = {
        row["id"]: CheckPoint(geo=_parse_position(row), element_guid=row["element_guid"])
        for row in read_truth_rows(folder / "checkpoints.csv", "id", "id", "element_guid", *_GEO)
    }
    path = folder / "detections.csv"
    check_point_of_annotation: dict[tuple[str, str], str | None] = {}
    for row in read_truth_rows(path, None, "file", "annotation_id", "checkpoint_id"):
        key, check_point = (row["file"], row["annotation_id"]), row["checkpoint_id"]
        if key in check_point_of_annotation:
            raise InputDataError(f"{row.place}: annotation {key[1]} of {key[0]} is listed twice; keep one line")
        if check_point != OFF_TARGET and check_point not in checkpoints:
            raise InputDataError(
                f"{row.place}, column checkpoint_id: '{check_point}' is neither an id of checkpoints.csv nor "
                f"'{OFF_TARGET}'"
            )
        check_point_of_annotation[key] = None if check_point == OFF_TARGET else check_point
    return Truth(cameras=cameras, checkpoints=checkpoints, check_point_of_annotation=check_point_of_annotation)


def _parse_position(row: CsvRow) -> Float64x3:
    limits = {"lon_deg": 180.0, "lat_deg": 90.0, "height_ellipsoidal_m": 10000.0}
    values = []
    for column, limit in limits.items():
        try:
            value = float(row[column])
        except ValueError:
            value = float("nan")
        if not abs(value) <= limit:
            raise InputDataError(
                f"{row.place}, column {column}: '{row[column]}' is not a number from {-limit:g} to {limit:g} "
                "(EPSG:4979)"
            )
        values.append(value)
    return np.array(values)
