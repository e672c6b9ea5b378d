"""The truth folder: published cameras, check points, and which annotation shows which check point."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.core.errors import InputDataError

OFF_TARGET = "off_target"
_GEO = ("lon_deg", "lat_deg", "height_ellipsoidal_m")


@dataclass(frozen=True, kw_only=True, eq=False)
class CheckPoint:
    """A point measured independently of the run; ``geo`` is lon, lat (deg), ellipsoidal height (m), EPSG:4979."""

    geo: Float64Array
    element_guid: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """Cameras by photograph (EPSG:4979), check points by id, and the check point that an annotation of a file shows.

    An annotation that shows none (a false detection) has None.
    """

    cameras: Mapping[str, Float64Array]
    checkpoints: Mapping[str, CheckPoint]
    check_point_of_annotation: Mapping[tuple[str, str], str | None]

    @property
    def files(self) -> frozenset[str]:
        """The detections files that truth knows."""
        return frozenset(file for file, _ in self.check_point_of_annotation)


def read_truth(folder: Path) -> Truth:
    """Read ``cameras.csv``, ``checkpoints.csv`` and ``detections.csv`` of a truth folder.

    Positions are taken from the EPSG:4979 columns alone, because the site frame's origin may differ from truth's.
    Raises InputDataError that names file, line, column, value and remedy.
    """
    cameras = {
        row["image"]: _parse_position(row) for row in _read_rows(folder / "cameras.csv", "image", "image", *_GEO)
    }
    checkpoints = {
        row["id"]: CheckPoint(geo=_parse_position(row), element_guid=row["element_guid"])
        for row in _read_rows(folder / "checkpoints.csv", "id", "id", "element_guid", *_GEO)
    }
    path = folder / "detections.csv"
    shown: dict[tuple[str, str], str | None] = {}
    for row in _read_rows(path, None, "file", "annotation_id", "checkpoint_id"):
        key, target = (row["file"], row["annotation_id"]), row["checkpoint_id"]
        if key in shown:
            raise InputDataError(f"{row.place}: annotation {key[1]} of {key[0]} is listed twice; keep one line")
        if target != OFF_TARGET and target not in checkpoints:
            raise InputDataError(
                f"{row.place}, column checkpoint_id: '{target}' is neither an id of checkpoints.csv nor '{OFF_TARGET}'"
            )
        shown[key] = None if target == OFF_TARGET else target
    return Truth(cameras=cameras, checkpoints=checkpoints, check_point_of_annotation=shown)


class _CsvRow(dict[str, str]):
    """A line of a CSV file that knows where it stands."""

    place: str


def _read_rows(path: Path, unique: str | None, *columns: str) -> list[_CsvRow]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream)
            missing = sorted(set(columns) - set(reader.fieldnames or ()))
            if missing:
                raise InputDataError(
                    f"{path} has no column {', '.join(missing)} (it has {reader.fieldnames}); "
                    f"truth needs {', '.join(columns)}"
                )
            rows = []
            for line in reader:
                row = _CsvRow({name: line[name] or "" for name in columns})
                row.place = f"{path}, line {reader.line_num}"
                rows.append(row)
    except OSError as error:
        raise InputDataError(
            f"truth file {path} cannot be read ({error.strerror}); give the folder that holds cameras.csv, "
            "checkpoints.csv and detections.csv"
        ) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputDataError(f"truth file {path} is not a CSV table in UTF-8: {error}") from error
    seen: set[str] = set()
    for row in rows if unique is not None else ():
        name = row[unique or ""]
        if not name or name in seen:
            raise InputDataError(
                f"{row.place}, column {unique}: '{name}' is empty or listed twice; give each line its own"
            )
        seen.add(name)
    return rows


def _parse_position(row: _CsvRow) -> Float64Array:
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
