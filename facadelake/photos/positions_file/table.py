"""Positions of photographs in a file, such as those of post-processed GNSS (PPK), in place of those of the metadata.

A table of text with a header: the columns of RTKLIB (``.pos``), Emlid, Pix4D's geolocation files and plain ones are
recognised by name. A file without a header needs the names of its columns in the portfolio: latitude and longitude
are not told apart by their values. RTKLIB's own files name epochs, not photographs; they need a column of names.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from facadelake.core.errors import GeoreferenceError, InputDataError
from facadelake.core.geodesy import transform
from facadelake.core.proj.crs import GEO
from facadelake.core.proj.operations import METRES_PER_DEGREE
from facadelake.photos.gps_block import GpsAltitude, GpsAngle, parse_gps_altitude, parse_gps_angle
from facadelake.photos.position_prior import PositionPrior, check_position
from facadelake.photos.position_sigma import PositionSigma, widen_by_steps
from facadelake.photos.positions_file.accuracies import check_unit, read_sigma
from facadelake.photos.positions_file.columns import HEIGHTS, PositionColumns, PositionLine, read_columns
from facadelake.photos.positions_file.numbers import find_step, parse_number
from schemas.vocabulary import HeightDatum, PositionSource

ELLIPSOIDAL = "ellipsoidal"  # keyword in place of a vertical CRS
_AXES = {"lat": "latitude", "lon": "longitude"}
_ELLIPSOIDAL_REFS = (2, 3)  # values of GPSAltitudeRef


@dataclass(frozen=True, kw_only=True)
class PositionFileFormat:
    """What the portfolio says of a file of positions.

    ``columns`` are the names of the columns where the file has no header; ``vertical`` is the datum of the heights,
    ``ellipsoidal`` or a vertical CRS, empty where the file states it or nobody does; ``sigma`` is that of positions
    without one, None where it is not known.
    """

    columns: tuple[str, ...] = ()
    vertical: str = ""
    sigma: PositionSigma | None = None


@dataclass(frozen=True, kw_only=True)
class PositionFile:
    """The positions of a file by the names of photographs in it.

    ``problems`` are the lines that are not used, ``remarks`` are how columns are taken.
    """

    path: Path
    positions: Mapping[str, PositionPrior]
    problems: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def read_position_file(path: Path, layout: PositionFileFormat) -> PositionFile:
    """Read a file of positions.

    Args:
        path: the file.
        layout: what the portfolio says of it.

    Returns:
        Its positions; lines that are not readable are among the problems.

    Raises:
        InputDataError: the file cannot be read, its columns are unknown or ambiguous, or no line is usable.
    """
    try:
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputDataError(f"the positions file {path} cannot be read ({error}); save it as UTF-8 text") from error
    columns = read_columns(path, text, layout.columns)
    height = _choose_height(columns, layout)
    datum = _find_datum(path, height, text, layout)
    lines = [(line, columns.get_values(line)) for line in columns.lines]
    delimiter = columns.delimiter
    step_m = METRES_PER_DEGREE * find_step(values[axis] for _, values in lines for axis in ("lat", "lon"))
    height_step_m = find_step(values.get(height, "") for _, values in lines)
    remarks = [check_unit(path, columns, [values for _, values in lines]), *_list_remarks(path, columns, height)]
    found: dict[str, list[PositionPrior]] = defaultdict(list)
    problems: list[str] = []
    for line, values in lines:
        name, where = values["name"], f"line {line.number} ({line.text[:60]})"
        lat, lon = (_parse_angle(values, axis, delimiter) for axis in ("lat", "lon"))
        altitude, no_height = _parse_height(values, height, delimiter)
        unread = ("" if layout.columns else _find_extra_fields(line, columns)) or lat.problem or lon.problem
        unread = unread or check_position(lon.angle_deg, lat.angle_deg) or no_height
        problem = unread if name else "no name"
        if problem:
            problems.append(f"{where}: {problem}")
            continue
        row_datum = HeightDatum.ELLIPSOIDAL if altitude.ref in _ELLIPSOIDAL_REFS else datum
        if datum not in (HeightDatum.UNKNOWN, row_datum):
            problems.append(
                f"{where}: its height reference {altitude.ref} is the ellipsoid, and the "
                f"heights are {datum} by the file or the portfolio"
            )
            continue
        stated = read_sigma(values, columns, path, layout.sigma)
        sigma, rounding = widen_by_steps(stated.sigma, step_m, height_step_m)
        warnings = [text for text in (lat.warning, lon.warning, altitude.warning) if text]
        warnings += [*stated.warnings, *(f"{path.name}: {text}" for text in rounding)]
        prior = PositionPrior(
            source=PositionSource.FILE,
            lon_deg=lon.angle_deg,
            lat_deg=lat.angle_deg,
            height_m=altitude.altitude_m,
            height_datum=row_datum,
            sigma=sigma,
            evidence=f"{path.name} line {line.number}, {stated.evidence}; height {_describe_datum(row_datum)}",
            warnings=tuple(warnings),
        )
        found[name].append(_convert_height(prior, layout))
    positions = {name: same[0] for name, same in found.items() if _are_equal(same)}
    problems += [f"'{name}' has {len(found[name])} different positions" for name in found if name not in positions]
    if not positions:
        first = f": {problems[0]}" if problems else ""
        raise InputDataError(f"the positions file {path} has no usable line{first}")
    return PositionFile(path=path, positions=positions, problems=tuple(problems), remarks=tuple(filter(None, remarks)))


def _find_extra_fields(line: PositionLine, columns: PositionColumns) -> str:
    """Why a line is not read by the columns: it has more fields, so that a comma or a blank in one divides it."""
    count = len(line.fields) - sum(not field.strip() for field in line.fields[columns.count :])
    if count <= columns.count:
        return ""
    return f"{count} fields for {columns.count} columns (a decimal comma, or a blank in a name?)"


def _parse_angle(values: Mapping[str, str], axis: str, delimiter: str) -> GpsAngle:
    """Latitude or longitude (``axis`` lat or lon), by its reference where the file has a column of it."""
    text = values.get(axis, "")
    angle_deg = parse_number(text, delimiter)
    if text and math.isnan(angle_deg):
        return GpsAngle(problem=f"{_AXES[axis]} '{text[:30]}' is not a number of degrees")
    if f"{axis}_ref" not in values or math.isnan(angle_deg):
        return GpsAngle(angle_deg=angle_deg)
    return parse_gps_angle(angle_deg, values[f"{axis}_ref"], _AXES[axis])


def _parse_height(values: Mapping[str, str], kind: str, delimiter: str) -> tuple[GpsAltitude, str]:
    """The height by its reference, if there is one, and why it is none; without a value it is NaN, without a reason."""
    text = values.get(kind, "")
    if not text:
        return GpsAltitude(), ""
    height_m = parse_number(text, delimiter)
    if math.isnan(height_m):
        return GpsAltitude(), f"height '{text[:20]}' is not a number"
    if not values.get("height_ref", ""):
        return GpsAltitude(altitude_m=height_m), ""
    return parse_gps_altitude(height_m, values["height_ref"]), ""


def _choose_height(columns: PositionColumns, layout: PositionFileFormat) -> str:
    """The kind of the column of heights that is used; empty where there is none.

    A stated datum is used before none, unless the portfolio says that of the heights.
    """
    kinds = HEIGHTS if layout.vertical in ("", ELLIPSOIDAL) else ("orthometric", "ellipsoidal", "height")
    if layout.vertical == ELLIPSOIDAL:
        kinds = ("ellipsoidal", "height", "orthometric")
    return next((kind for kind in kinds if kind in columns.index), "")


def _list_remarks(path: Path, columns: PositionColumns, height: str) -> list[str]:
    """Which columns of heights or accuracies are not used, where the choice is not evident."""
    remarks = []
    others = [columns.names[kind] for kind in HEIGHTS if kind in columns.index and kind != height]
    if others and height != "ellipsoidal":
        remarks.append(
            f"{path.name}: heights are those of column '{columns.names[height]}'; not used: {', '.join(others)}"
        )
    if columns.unrecognised:
        remarks.append(
            f"{path.name}: columns not recognised, and not used: {', '.join(columns.unrecognised)}; recognised "
            "are 'ellipsoidal height', 'orthometric height', 'sigma_horizontal_m', 'sigma_vertical_m' and the like"
        )
    return remarks


def _find_datum(path: Path, height: str, text: str, layout: PositionFileFormat) -> HeightDatum:
    """The datum of the heights as file or portfolio state it, else unknown. Raises InputDataError where they differ."""
    stated = HeightDatum.UNKNOWN
    if height == "ellipsoidal" or re.search(r"height\s*=\s*WGS84/ellipsoidal", text):
        stated = HeightDatum.ELLIPSOIDAL
    elif height == "orthometric" or re.search(r"height\s*=\s*WGS84/geodetic", text):
        stated = HeightDatum.ORTHOMETRIC
    if not layout.vertical:
        return stated
    given = HeightDatum.ELLIPSOIDAL if layout.vertical == ELLIPSOIDAL else HeightDatum.ORTHOMETRIC
    if stated not in (HeightDatum.UNKNOWN, given):
        raise InputDataError(
            f"the positions file {path} states that its heights are {stated}, the portfolio 'vertical: "
            f"{layout.vertical}'; correct the one that is wrong"
        )
    return given


def _describe_datum(datum: HeightDatum) -> str:
    return "of unknown datum" if datum is HeightDatum.UNKNOWN else f"{datum} by the file or the portfolio"


def _convert_height(prior: PositionPrior, layout: PositionFileFormat) -> PositionPrior:
    """The prior with its height above the ellipsoid, where the portfolio names its vertical CRS."""
    if layout.vertical in ("", ELLIPSOIDAL) or math.isnan(prior.height_m):
        return prior
    source = f"EPSG:4326+{layout.vertical.upper().removeprefix('EPSG:')}"
    try:
        geo = transform(np.array([[prior.lon_deg, prior.lat_deg, prior.height_m]]), source, GEO)
    except GeoreferenceError as error:
        raise InputDataError(f"the heights of the positions file cannot be converted: {error}") from error
    return replace(
        prior,
        height_m=float(geo[0, 2]),
        height_datum=HeightDatum.ELLIPSOIDAL,
        evidence=f"{prior.evidence}, {prior.height_m:.2f} m above {layout.vertical} converted to ellipsoidal",
    )


def _are_equal(priors: Sequence[PositionPrior]) -> bool:
    first = priors[0]
    return all(
        (prior.lon_deg, prior.lat_deg) == (first.lon_deg, first.lat_deg)
        and (prior.height_m == first.height_m or (math.isnan(prior.height_m) and math.isnan(first.height_m)))
        for prior in priors[1:]
    )
