"""Surveyed points (control and check points): OpenDroneMap's gcp_list.txt, and the photographs it names.

Pixels are in the product's convention: (0, 0) is the image's corner and (0.5, 0.5) the centre of the top left pixel,
which is what viewers and marking tools report. (OpenSfM, inside OpenDroneMap, reads them with (0, 0) as that centre:
half a pixel, about 2 mm on a facade at 10 m.)
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyproj

from facadelake.core.arrays import Float64Nx3
from facadelake.core.errors import GeoreferenceError, InputDataError
from facadelake.core.photo_names import PhotoNames
from facadelake.core.proj.crs import check_area_of_use, combine_crs, mask_in_area_of_use, promote_to_3d
from facadelake.georeferencing.datum_shift import site_from_crs
from facadelake.georeferencing.site_frame import SiteFrame

_UTM = re.compile(r"^WGS\s*84\s+UTM\s+(\d{1,2})\s*([NS])$", re.IGNORECASE)
# The name of a photograph, which may hold blanks: in quotes, else up to the suffix of an image file.
_QUOTED = re.compile(r"""(["'])(?P<photo>.+?)\1(?:\s+(?P<name>.*))?$""")
_WITH_SUFFIX = re.compile(
    r"(?P<photo>.+?\.(?:jpe?g|jpe|jfif|png|tiff?|webp|heic|heif|dng|cr2|cr3|nef|arw|raf|rw2|orf))(?:\s+(?P<name>.*))?$",
    re.IGNORECASE,
)
# Coordinates of one point were rounded differently where they differ by half their last digit, and at most by this
# (metres or feet; degrees of a geographic CRS).
_ROUNDING_MAX = 0.05
_ROUNDING_MAX_DEG = 5e-7
# Marks of one point in one photograph that differ by more contradict each other: 3 sigma of a mark set by hand.
_SAME_MARK_PX = 3.0
_REASONS_MAX = 3


@dataclass(frozen=True, kw_only=True)
class ImageMark:
    """The pixel at which a surveyed point was marked in a photograph.

    ``photo_name`` is as written in the file, and a ``photo_id`` after ``match_marks``.
    """

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
    """The points of one file; ``crs`` is its header in a form that PROJ reads. ``remarks``: what was not used of it."""

    source: str
    crs: str
    points: tuple[SurveyedPoint, ...]
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class _PointRecord:
    """One parsed line of the file. ``last_digit``: the value of the last digit of each coordinate as written.

    ``name``: all that follows the photograph's name.
    """

    number: int
    xyz: tuple[float, float, float]
    last_digit: tuple[float, float, float]
    mark: ImageMark
    name: str


def read_surveyed_points(path: Path) -> SurveyedPoints:
    """Read an OpenDroneMap gcp_list.txt: a header with the CRS, then ``x y z pixel_x pixel_y photograph [name]``.

    Header: an EPSG code, a PROJ string or "WGS84 UTM 32N". Columns are separated by tabs or blanks; empty lines and
    lines that begin with # are skipped. Names may be quoted, and may hold blanks where a photograph's name ends with
    the suffix of an image file. Lines without a name and with equal coordinates are marks of one point; coordinates of
    one point may be rounded differently, and those with most digits count.
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
    horizontal_max = _ROUNDING_MAX_DEG if pyproj.CRS.from_user_input(crs).is_geographic else _ROUNDING_MAX
    rounding_max = (horizontal_max, horizontal_max, _ROUNDING_MAX)
    points, remarks = _group_by_point(path, _shorten_names(records, rounding_max), rounding_max)
    return SurveyedPoints(source=path.name, crs=crs, points=points, remarks=remarks)


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
    in_tabs = line.count("\t") >= 5
    fields = [part.strip() for part in line.split("\t")] if in_tabs else line.split(maxsplit=5)
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
    photo, name = (fields[5], " ".join(fields[6:7])) if in_tabs else _split_names(path, number, fields[5])
    return _PointRecord(
        number=number,
        xyz=(x, y, z),
        last_digit=(_value_last_digit(fields[0]), _value_last_digit(fields[1]), _value_last_digit(fields[2])),
        mark=ImageMark(photo_name=photo, x_px=x_px, y_px=y_px),
        name=name.strip("\"' "),
    )


def _split_names(path: Path, number: int, text: str) -> tuple[str, str]:
    """The photograph's name and what follows it."""
    found = _QUOTED.match(text) or _WITH_SUFFIX.match(text)
    if found:
        return found["photo"], found["name"] or ""
    photo, *rest = text.split()
    if len(rest) > 1:
        raise InputDataError(
            f"{path}, line {number}: '{text}' may be split into a photograph and a point in more than one way; quote "
            "names with blanks, or separate the columns by tabs"
        )
    return photo, " ".join(rest)


def _value_last_digit(text: str) -> float:
    exponent = Decimal(text).as_tuple().exponent
    return float(Decimal(10) ** int(exponent))


def _shorten_names(records: Sequence[_PointRecord], rounding_max: tuple[float, float, float]) -> list[_PointRecord]:
    """The records with the first words of their names, where these are one point each; else as they are.

    Columns after the name are allowed ("G1 first mark", "G1 blurred"), and names with blanks, too ("GCP 1", "GCP 2").
    """
    short = [replace(record, name=next(iter(record.name.split()), "")) for record in records]
    first: dict[str, _PointRecord] = {}
    are_points = all(
        _is_same_place(first.setdefault(record.name, record), record, rounding_max) for record in short if record.name
    )
    return short if are_points and len(first) < len({record.name for record in records} - {""}) else list(records)


def _group_by_point(
    path: Path, records: Sequence[_PointRecord], rounding_max: tuple[float, float, float]
) -> tuple[tuple[SurveyedPoint, ...], tuple[str, ...]]:
    """The points in the file's order, and remarks on coordinates that differ.

    Raises InputDataError where one name is at two places.
    """
    groups: dict[str, list[_PointRecord]] = {}
    unnamed: list[str] = []
    for record in records:
        name = record.name
        if not name:
            same = (other for other in unnamed if _is_same_place(groups[other][0], record, rounding_max))
            name = next(same, f"point {len(unnamed) + 1}")
            unnamed += [] if name in unnamed else [name]
        first = groups.setdefault(name, [record])[0]
        if first is record:
            continue
        differing = (other for other in groups[name] if not _is_same_place(other, record, rounding_max))
        if (other := next(differing, None)) is not None:
            raise InputDataError(
                f"{path}, line {record.number}: {name} is at {record.xyz}, but in line {other.number} at {other.xyz}; "
                "use one name for one point"
            )
        groups[name].append(record)
    points, rounded = [], []
    for name, group in groups.items():
        x, y, z = (min(group, key=lambda record: record.last_digit[axis]).xyz[axis] for axis in range(3))
        points.append(SurveyedPoint(name=name, x=x, y=y, z=z, marks=tuple(record.mark for record in group)))
        if any(record.xyz != group[0].xyz for record in group):
            rounded.append(name)
    remarks = [
        f"coordinates are rounded differently in the lines of {', '.join(rounded)}; those with most digits count"
    ]
    return tuple(points), tuple(remarks if rounded else ())


def _is_same_place(one: _PointRecord, other: _PointRecord, rounding_max: tuple[float, float, float]) -> bool:
    """Whether coordinates differ by no more than half the last digit of the coarser ones (and a float's rounding)."""
    return all(
        abs(a - b) <= 1.001 * min(max(digits) / 2, limit) + 1e-9 * limit
        for a, b, digits, limit in zip(
            one.xyz, other.xyz, zip(one.last_digit, other.last_digit, strict=True), rounding_max, strict=True
        )
    )


def match_marks(surveyed: SurveyedPoints, photo_ids: Iterable[str]) -> SurveyedPoints:
    """The points with marks that name a ``photo_id``; other marks are left out, with remarks.

    ``photo_ids``: all photographs of the campaign, used or not: a name that matches an unreadable one, too, is
    ambiguous.
    """
    matches = PhotoNames(photo_ids).match_all(mark.photo_name for point in surveyed.points for mark in point.marks)
    reasons = list(dict.fromkeys(match.reason for match in matches.values() if match.photo_id is None))
    remarks = list(surveyed.remarks)
    if reasons:
        count = sum(matches[mark.photo_name].photo_id is None for point in surveyed.points for mark in point.marks)
        more = f"; and {len(reasons) - _REASONS_MAX} more names" if len(reasons) > _REASONS_MAX else ""
        remarks.append(f"{count} marks of {surveyed.source} are not used: {'; '.join(reasons[:_REASONS_MAX])}{more}")
    points = []
    for point in surveyed.points:
        marks: dict[str, ImageMark] = {}
        contradicted = set()
        for mark in point.marks:
            photo_id = matches[mark.photo_name].photo_id
            if photo_id is None:
                continue
            first = marks.setdefault(photo_id, replace(mark, photo_name=photo_id))
            if math.hypot(first.x_px - mark.x_px, first.y_px - mark.y_px) > _SAME_MARK_PX:
                contradicted.add(photo_id)
                remarks.append(
                    f"{point.name} is marked in {photo_id} at {first.x_px:g}, {first.y_px:g} and at {mark.x_px:g}, "
                    f"{mark.y_px:g} px (limit {_SAME_MARK_PX:g} px apart): none of these marks is used"
                )
        kept = tuple(mark for photo_id, mark in marks.items() if photo_id not in contradicted)
        points.append(replace(point, marks=kept))
    return replace(surveyed, points=tuple(points), remarks=tuple(remarks))


def describe_doubtful_marks(surveyed: SurveyedPoints, photos: pa.Table) -> tuple[str, ...]:
    """Remarks on marks (of photo_ids) outside their photograph, or in photographs that EXIF turns.

    Viewers turn these, and the file does not tell of which view its pixels are. ``photos``: table ``photos``.
    """
    columns = ["photo_id", "image_width_px", "image_height_px", "exif_orientation"]
    rows = {row["photo_id"]: row for row in photos.select(columns).to_pylist()}
    marks = [(point.name, mark) for point in surveyed.points for mark in point.marks]
    turned = sorted({mark.photo_name for _, mark in marks if (rows[mark.photo_name]["exif_orientation"] or 1) != 1})
    outside = []
    for name, mark in marks:
        width, height = (rows[mark.photo_name][f"image_{side}_px"] for side in ("width", "height"))
        if None not in (width, height) and not (0 <= mark.x_px <= width and 0 <= mark.y_px <= height):
            outside.append(f"{name} in {mark.photo_name} at {mark.x_px:g}, {mark.y_px:g} px")
    remarks = []
    if outside:
        remarks.append(f"marks outside their photographs: {_abbreviate(outside)}; check x and y, and for which size")
    if turned:
        remarks.append(
            f"EXIF turns {_abbreviate(turned)}: marks there are taken in the pixels as stored; store photographs "
            "upright"
        )
    return tuple(remarks)


def _abbreviate(names: Sequence[str]) -> str:
    more = f" and {len(names) - _REASONS_MAX} more" if len(names) > _REASONS_MAX else ""
    return ", ".join(names[:_REASONS_MAX]) + more


def transform_to_site(surveyed: SurveyedPoints, site_frame: SiteFrame) -> Float64Nx3:
    """The points (n, 3) in site metres; NaN for a point outside the area of use of its CRS, where most are inside.

    Where the file's CRS has no vertical part, heights are taken in the model's vertical datum: surveyor and model share
    it in most cases. Their unit is that of east and north in a projected CRS, as PROJ reads ``+units`` without
    ``+vunits``. Raises GeoreferenceError where half of the points or more are outside.
    """
    xyz = np.array([[point.x, point.y, point.z] for point in surveyed.points]).reshape(-1, 3)
    inside = mask_in_area_of_use(xyz, surveyed.crs)
    if 2 * inside.sum() <= len(xyz):
        try:
            check_area_of_use(xyz, surveyed.crs)
        except GeoreferenceError as error:
            raise GeoreferenceError(f"control points {surveyed.source}: {error}") from error
    xyz_site = np.full(xyz.shape, np.nan)
    crs = add_vertical_datum(surveyed.crs, site_frame.vertical_datum)
    xyz[:, 2] *= compute_height_factor(surveyed.crs, crs)
    try:
        xyz_site[inside] = site_from_crs(xyz[inside], crs, site_frame)
    except GeoreferenceError as error:
        raise GeoreferenceError(f"control points {surveyed.source}: {error}") from error
    return xyz_site


def get_height_unit_m(crs: str) -> float:
    """Metres per unit of heights that are given in ``crs`` without a vertical part: the unit of a projected CRS."""
    parsed = pyproj.CRS.from_user_input(crs)
    if has_own_heights(crs) or not parsed.is_projected:
        return 1.0  # PROJ converts the unit of a height axis
    return float(parsed.axis_info[0].unit_conversion_factor)


def has_own_heights(crs: str) -> bool:
    """Whether the CRS has a height axis, compound or three-dimensional."""
    parsed = pyproj.CRS.from_user_input(crs)
    return bool(parsed.is_compound or len(parsed.axis_info) == 3)


def compute_height_factor(crs: str, crs_with_heights: str) -> float:
    """Factor from heights given beside coordinates of ``crs`` to the height axis of ``crs_with_heights``.

    1 where ``crs`` has heights of its own; a vertical CRS in feet (EPSG:6360) beside a map in metres has another unit.
    """
    if has_own_heights(crs):
        return 1.0
    axes = promote_to_3d(crs_with_heights).axis_info
    return get_height_unit_m(crs) / (float(axes[2].unit_conversion_factor) if len(axes) == 3 else 1.0)


def add_vertical_datum(crs: str, vertical_datum: str) -> str:
    """``crs`` with heights: its own, else those of ``vertical_datum``."""
    return crs if has_own_heights(crs) else combine_crs(crs, vertical_datum)
