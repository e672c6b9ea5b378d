"""Surveyed points (control and check points): OpenDroneMap's gcp_list.txt, and the photographs it names.

Pixels are in the product's convention: (0, 0) is the image's corner and (0.5, 0.5) the centre of the top left pixel,
which is what viewers and marking tools report. (OpenSfM, inside OpenDroneMap, reads them with (0, 0) as that centre:
half a pixel, about 2 mm on a facade at 10 m.)
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
import pyproj
from pyproj.crs import CompoundCRS
from pyproj.exceptions import CRSError

from facadelake.core.arrays import Float64Nx3
from facadelake.core.errors import GeoreferenceError, InputDataError
from facadelake.core.geodesy import GEO, SiteOrigin, check_area_of_use, promote_to_3d, transform

_UTM = re.compile(r"^WGS\s*84\s+UTM\s+(\d{1,2})\s*([NS])$", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class ImageMark:
    """The pixel at which a surveyed point was marked in a photograph (the name as written in the file)."""

    photo_name: str
    x_px: float
    y_px: float


@dataclass(frozen=True, kw_only=True)
class SurveyedPoint:
    """A surveyed point, x (east or longitude) before y, in the file's CRS, and its image marks."""

    name: str
    x: float
    y: float
    z: float
    marks: tuple[ImageMark, ...]


@dataclass(frozen=True, kw_only=True)
class SurveyedPoints:
    """The points of one file; ``crs`` is its header in a form that PROJ reads."""

    source: str
    crs: str
    points: tuple[SurveyedPoint, ...]


@dataclass(frozen=True, kw_only=True)
class _PointRecord:
    """One parsed line of the file."""

    number: int
    xyz: tuple[float, float, float]
    mark: ImageMark
    name: str


def read_surveyed_points(path: Path) -> SurveyedPoints:
    """Read an OpenDroneMap gcp_list.txt: a header with the CRS, then ``x y z pixel_x pixel_y photograph [name]``.

    Header: an EPSG code, a PROJ string or "WGS84 UTM 32N". Columns are separated by tabs or blanks; empty lines and
    lines that begin with # are skipped. Lines without a name and with equal coordinates are marks of one point.
    Raises InputDataError with file, line and value.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputDataError(f"control points {path} cannot be read: {error}") from error
    numbered = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1)]
    content = [(number, line) for number, line in numbered if line and not line.startswith("#")]
    if not content:
        raise InputDataError(f"control points {path}: the file is empty; its first line must be a CRS (EPSG:25832)")
    crs = _parse_header(path, *content[0])
    records = [_parse_line(path, number, line) for number, line in content[1:]]
    return SurveyedPoints(source=path.name, crs=crs, points=_group_by_point(path, records))


def _parse_header(path: Path, number: int, line: str) -> str:
    utm = _UTM.match(line)
    text = f"EPSG:{32600 + int(utm[1]) + (100 if utm[2].upper() == 'S' else 0)}" if utm else line
    try:
        promote_to_3d(text)
    except GeoreferenceError as error:
        raise InputDataError(
            f"{path}, line {number}: '{line}' is not a CRS; write an EPSG code (EPSG:25832), a PROJ string "
            "(+proj=utm ...) or 'WGS84 UTM 32N' in the first line"
        ) from error
    return text


def _parse_line(path: Path, number: int, line: str) -> _PointRecord:
    fields = [part.strip() for part in line.split("\t")] if line.count("\t") >= 5 else line.split()
    if len(fields) < 6:
        raise InputDataError(
            f"{path}, line {number}: {len(fields)} columns in '{line}'; expected "
            "x y z pixel_x pixel_y photograph [name]"
        )
    values: list[float] = []
    for column, field in zip(("x", "y", "z", "pixel_x", "pixel_y"), fields, strict=False):
        try:
            value = float(field)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InputDataError(f"{path}, line {number}: {column} is '{field}'; expected a finite number")
        values.append(value)
    x, y, z, x_px, y_px = values
    return _PointRecord(
        number=number,
        xyz=(x, y, z),
        mark=ImageMark(photo_name=fields[5].replace("\\", "/"), x_px=x_px, y_px=y_px),
        name=fields[6] if len(fields) > 6 else "",
    )


def _group_by_point(path: Path, records: Sequence[_PointRecord]) -> tuple[SurveyedPoint, ...]:
    groups: dict[str, list[_PointRecord]] = {}
    unnamed: dict[tuple[float, float, float], str] = {}
    for record in records:
        name = record.name or unnamed.setdefault(record.xyz, f"point {len(unnamed) + 1}")
        first = groups.setdefault(name, [record])[0]
        if first is record:
            continue
        if first.xyz != record.xyz:
            raise InputDataError(
                f"{path}, line {record.number}: {name} is at {record.xyz}, but in line {first.number} at {first.xyz}; "
                "use one name for one point"
            )
        groups[name].append(record)
    return tuple(
        SurveyedPoint(
            name=name,
            x=group[0].xyz[0],
            y=group[0].xyz[1],
            z=group[0].xyz[2],
            marks=tuple(record.mark for record in group),
        )
        for name, group in groups.items()
    )


def match_photo_names(names: Sequence[str], photo_ids: Sequence[str]) -> dict[str, str]:
    """The photograph that each name stands for: its id, else the only id that ends with it (case-insensitive)."""
    found: dict[str, str] = {}
    parts_of = {photo_id: PurePosixPath(photo_id.lower()).parts for photo_id in photo_ids}
    for name in set(names):
        parts = PurePosixPath(name.lower()).parts
        candidates = [photo_id for photo_id, id_parts in parts_of.items() if id_parts[-len(parts) :] == parts]
        if name in parts_of:
            found[name] = name
        elif len(candidates) == 1:
            found[name] = candidates[0]
    return found


def transform_to_site(surveyed: SurveyedPoints, *, origin: SiteOrigin, vertical_datum: str) -> Float64Nx3:
    """The points (n, 3) in site metres.

    Where the file's CRS has no vertical part, heights are taken in ``vertical_datum`` ("ellipsoidal" or a vertical CRS
    such as "EPSG:5783"), the model's: surveyor and model share it in most cases. Raises GeoreferenceError for points
    outside the area of use of their CRS.
    """
    xyz = np.array([[point.x, point.y, point.z] for point in surveyed.points]).reshape(-1, 3)
    try:
        check_area_of_use(xyz, surveyed.crs)
    except GeoreferenceError as error:
        raise GeoreferenceError(f"control points {surveyed.source}: {error}") from error
    return origin.site_from_geo(transform(xyz, add_vertical_datum(surveyed.crs, vertical_datum), GEO))


def has_own_heights(crs: str) -> bool:
    """Whether the CRS has a height axis, compound or three-dimensional."""
    parsed = pyproj.CRS.from_user_input(crs)
    return bool(parsed.is_compound or len(parsed.axis_info) == 3)


def add_vertical_datum(crs: str, vertical_datum: str) -> str:
    """``crs`` with heights: its own, else those of ``vertical_datum``."""
    if has_own_heights(crs) or not vertical_datum.upper().startswith("EPSG:"):
        return crs
    try:
        horizontal, vertical = pyproj.CRS.from_user_input(crs), pyproj.CRS.from_user_input(vertical_datum)
        compound = CompoundCRS(name=f"{horizontal.name} + {vertical.name}", components=[horizontal, vertical])
    except CRSError as error:
        raise GeoreferenceError(
            f"the control points' CRS {crs} cannot be combined with the vertical CRS {vertical_datum}: {error}; "
            "name a compound CRS in the header of the control points"
        ) from error
    return str(compound.to_wkt())
