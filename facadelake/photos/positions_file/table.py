"""Positions of photographs in a file, such as those of post-processed GNSS (PPK), in place of those of the metadata.

A table of text with a header: the columns of RTKLIB (``.pos``), Emlid, Pix4D's geolocation files and plain ones are
recognised by name. A file without a header needs the names of its columns in the portfolio: latitude and longitude
are not told apart by their values. RTKLIB's own files name epochs, not photographs; they need a column of names.
"""

from __future__ import annotations

import csv
import math
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from facadelake.core.errors import GeoreferenceError, InputDataError
from facadelake.core.geodesy import transform
from facadelake.core.proj.crs import GEO
from facadelake.photos.gps_block import GpsAltitude, GpsAngle, parse_gps_altitude, parse_gps_angle
from facadelake.photos.position_prior import (
    METRES_PER_DEGREE,
    SIGMA_DRONE,
    SIGMA_RTK_FIXED,
    SIGMA_RTK_FLOAT,
    PositionPrior,
    PositionSigma,
    check_position,
)
from schemas.vocabulary import HeightDatum, PositionSource

ELLIPSOIDAL = "ellipsoidal"  # keyword in place of a vertical CRS
_COLUMNS: dict[str, str] = {
    **dict.fromkeys(
        ("name", "image", "imagename", "filename", "file", "photo", "photoid", "photograph", "label", "sourcefile"),
        "name",
    ),
    **dict.fromkeys(("latitude", "lat", "latdeg", "latitudedeg", "gpslatitude"), "lat"),
    **dict.fromkeys(("longitude", "lon", "long", "lng", "londeg", "longitudedeg", "gpslongitude"), "lon"),
    **dict.fromkeys(("ellipsoidalheight", "ellipsoidheight", "heightellipsoidal", "heightellipsoidalm"), "ellipsoidal"),
    **dict.fromkeys(("orthometricheight", "heightorthometric", "heightorthometricm"), "orthometric"),
    **dict.fromkeys(
        ("height", "heightm", "altitude", "altitudem", "alt", "elevation", "elev", "z", "gpsaltitude"), "height"
    ),
    **dict.fromkeys(
        (
            *("accuracyhorizontal", "horizontalaccuracy", "accuracyhorz", "horzaccuracy", "sigmahorizontal"),
            *("sigmahorizontalm", "gpsxyaccuracy", "lateralrms"),
        ),
        "horizontal",
    ),
    **dict.fromkeys(("sde", "sdem", "eastingrms", "sigmaeast", "sigmaeastm", "rtkstdlon"), "east"),
    **dict.fromkeys(("sdn", "sdnm", "northingrms", "sigmanorth", "sigmanorthm", "rtkstdlat"), "north"),
    **dict.fromkeys(
        (
            *("sdu", "sdum", "elevationrms", "accuracyvertical", "verticalaccuracy", "accuracyvert", "vertaccuracy"),
            *("sigmavertical", "sigmaverticalm", "gpszaccuracy", "rtkstdhgt"),
        ),
        "vertical",
    ),
    **dict.fromkeys(("q", "quality"), "quality"),
    **dict.fromkeys(("gpslatituderef", "latituderef", "latref", "latitudehemisphere", "lathemisphere"), "lat_ref"),
    **dict.fromkeys(("gpslongituderef", "longituderef", "lonref", "longitudehemisphere", "lonhemisphere"), "lon_ref"),
    **dict.fromkeys(("gpsaltituderef", "altituderef", "altref"), "height_ref"),
}
_REQUIRED = {"name": "photograph", "lat": "latitude", "lon": "longitude"}
_AXES = {"lat": "latitude", "lon": "longitude"}
_ELLIPSOIDAL_REFS = (2, 3)  # values of GPSAltitudeRef
_UNIT_ENDING = re.compile(r"(.*?)[ _-]*(us-?ft|us-?feet|ft|feet|foot|mm|cm|km|rad|dms)\s*")
_UNITS = ("", "deg", "degrees", "°", "decimal degrees", "dd", "m", "metre", "metres", "meter", "meters", "wgs84")
# RTKLIB: 1 fixed, 2 float, 3 SBAS, 4 DGPS, 5 single, 6 PPP.
_SIGMA_BY_QUALITY = {1.0: SIGMA_RTK_FIXED, 2.0: SIGMA_RTK_FLOAT}
_TIME_COLUMNS = ("gpst", "utc", "jst")  # RTKLIB writes date and time as two columns under one of these names


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
    """The positions of a file by the names of photographs in it; ``problems`` are the lines that are not used."""

    path: Path
    positions: Mapping[str, PositionPrior]
    problems: tuple[str, ...] = ()


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
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    header, rows, delimiter = _split_header(path, lines, layout)
    datum = _find_datum(path, header, text, layout)
    height = next((kind for kind in ("ellipsoidal", "orthometric", "height") if kind in header), None)
    step_m = _find_step_m([_split_line(line, delimiter) for _, line in rows], header)
    found: dict[str, list[PositionPrior]] = defaultdict(list)
    problems: list[str] = []
    for number, line in rows:
        fields = _split_line(line, delimiter)
        values = {kind: fields[i] if i < len(fields) else "" for kind, i in header.items()}
        name = values.get("name", "").strip()
        lat, lon = (_parse_angle(values, axis, delimiter) for axis in ("lat", "lon"))
        altitude, no_height = _parse_height(values, height, delimiter)
        unread = lat.problem or lon.problem or check_position(lon.angle_deg, lat.angle_deg) or no_height
        problem = unread if name else "no name"
        if problem:
            problems.append(f"line {number} ({line.strip()[:60]}): {problem}")
            continue
        row_datum = HeightDatum.ELLIPSOIDAL if altitude.ref in _ELLIPSOIDAL_REFS else datum
        if datum not in (HeightDatum.UNKNOWN, row_datum):
            problems.append(
                f"line {number} ({line.strip()[:60]}): its height reference {altitude.ref} is the ellipsoid, and the "
                f"heights are {datum} by the file or the portfolio"
            )
            continue
        sigma, evidence = _read_sigma(values, delimiter, layout)
        warnings = [text for text in (lat.warning, lon.warning, altitude.warning) if text]
        if "taken" in evidence:
            warnings.append(f"{path.name} states no accuracy; {evidence}")
        if step_m / math.sqrt(12) > 0.1 * sigma.horizontal_m:
            sigma = replace(sigma, horizontal_m=math.hypot(sigma.horizontal_m, step_m / math.sqrt(12)))
            warnings.append(f"{path.name} gives positions in steps of {step_m:.2g} m")
        prior = PositionPrior(
            source=PositionSource.FILE,
            lon_deg=lon.angle_deg,
            lat_deg=lat.angle_deg,
            height_m=altitude.altitude_m,
            height_datum=row_datum,
            sigma=sigma,
            evidence=f"{path.name} line {number}, {evidence}; height {_describe_datum(row_datum)}",
            warnings=tuple(warnings),
        )
        found[name].append(_convert_height(prior, layout))
    positions = {name: same[0] for name, same in found.items() if _are_equal(same)}
    problems += [f"'{name}' has {len(found[name])} different positions" for name in found if name not in positions]
    if not positions:
        first = f": {problems[0]}" if problems else ""
        raise InputDataError(f"the positions file {path} has no usable line{first}")
    return PositionFile(path=path, positions=positions, problems=tuple(problems))


def _choose_delimiter(line: str) -> str:
    return next((delimiter for delimiter in "\t;," if delimiter in line), " ")


def _split_line(line: str, delimiter: str) -> list[str]:
    fields = next(csv.reader([line.strip()], delimiter=delimiter, skipinitialspace=True))
    return [field.strip() for field in fields if field.strip() or delimiter != " "]


def _name_column(text: str) -> str:
    """The kind of a column by its name in a header; empty where it is none of those used. Raises ValueError: a unit."""
    name, unit = text.lower(), ""
    found = re.fullmatch(r"(.*?)[\[(]([^\])]*)[\])]?\s*", name)
    if found:
        name, unit = found[1], found[2].strip()
    kind = _COLUMNS.get(re.sub(r"[^a-z0-9]", "", name), "")
    ending = _UNIT_ENDING.fullmatch(name)
    if ending and not kind:
        kind, unit = _COLUMNS.get(re.sub(r"[^a-z0-9]", "", ending[1]), ""), ending[2]
    if kind and unit not in _UNITS:
        raise ValueError(f"column '{text}' is in {unit}; give degrees and metres")
    return kind


def _index_columns(path: Path, names: Iterable[str]) -> dict[str, int]:
    """The position of each kind of column. Raises InputDataError where one is missing or there twice."""
    index: dict[str, int] = {}
    try:
        for i, kind in enumerate(map(_name_column, names)):
            if kind in index:
                raise ValueError(f"two columns are the {kind}")
            if kind:
                index[kind] = i
    except ValueError as error:
        raise InputDataError(f"the positions file {path}: {error}") from error
    missing = [word for kind, word in _REQUIRED.items() if kind not in index]
    if missing:
        raise InputDataError(
            f"the positions file {path} has no column of {' and '.join(missing)}; give a header such as "
            "'name,latitude,longitude,ellipsoidal height,sigma_horizontal_m,sigma_vertical_m', or name the columns in "
            "the portfolio (positions: {file, columns})"
        )
    return index


def _split_header(
    path: Path, lines: Sequence[tuple[int, str]], layout: PositionFileFormat
) -> tuple[dict[str, int], Sequence[tuple[int, str]], str]:
    """The columns, the lines of data and the delimiter; the header may be a comment, as RTKLIB writes it."""
    data = [(number, line) for number, line in lines if line.lstrip()[0] not in "#%"]
    if layout.columns:
        return _index_columns(path, layout.columns), data, _choose_delimiter(data[0][1] if data else "")
    comments = [line.lstrip("#% ") for _, line in lines if line.lstrip()[0] in "#%"]
    for line in reversed(comments):
        delimiter = _choose_delimiter(line)
        names = _split_line(line, delimiter)
        if sum(bool(_COLUMNS.get(re.sub(r"[^a-z0-9]", "", name.lower().split("(")[0]))) for name in names) > 1:
            if delimiter == " ":
                names = [part for name in names for part in ([name, name] if name.lower() in _TIME_COLUMNS else [name])]
            return _index_columns(path, names), data, delimiter if not data else _choose_delimiter(data[0][1])
    if not data:
        raise InputDataError(f"the positions file {path} is empty")
    delimiter = _choose_delimiter(data[0][1])
    return _index_columns(path, _split_line(data[0][1], delimiter)), data[1:], delimiter


def _parse_number(text: str, delimiter: str) -> float:
    if delimiter == ";" and "." not in text:
        text = text.replace(",", ".")
    try:
        number = float(text)
    except ValueError:
        return math.nan
    return number if math.isfinite(number) else math.nan


def _parse_angle(values: Mapping[str, str], axis: str, delimiter: str) -> GpsAngle:
    """Latitude or longitude (``axis`` lat or lon), by its reference where the file has a column of it."""
    angle_deg = _parse_number(values.get(axis, ""), delimiter)
    if f"{axis}_ref" not in values or math.isnan(angle_deg):
        return GpsAngle(angle_deg=angle_deg)
    return parse_gps_angle(angle_deg, values[f"{axis}_ref"], _AXES[axis])


def _parse_height(values: Mapping[str, str], kind: str | None, delimiter: str) -> tuple[GpsAltitude, str]:
    """The height by its reference, if there is one, and why it is none; without a value it is NaN, without a reason."""
    text = values.get(kind or "", "").strip()
    if not text:
        return GpsAltitude(), ""
    height_m = _parse_number(text, delimiter)
    if math.isnan(height_m):
        return GpsAltitude(), f"height '{text[:20]}' is not a number"
    if not values.get("height_ref", ""):
        return GpsAltitude(altitude_m=height_m), ""
    return parse_gps_altitude(height_m, values["height_ref"]), ""


def _find_step_m(rows: Sequence[Sequence[str]], header: Mapping[str, int]) -> float:
    """The resolution of latitude and longitude by the number of their decimals, of the line with most of them."""
    digits = [
        len(row[header[axis]].replace(",", ".").partition(".")[2])
        for row in rows
        for axis in ("lat", "lon")
        if header[axis] < len(row)
    ]
    return METRES_PER_DEGREE * 10.0 ** -max(digits, default=0)


def _find_datum(path: Path, header: Mapping[str, int], text: str, layout: PositionFileFormat) -> HeightDatum:
    """The datum of the heights as file or portfolio state it, else unknown. Raises InputDataError where they differ."""
    stated = HeightDatum.UNKNOWN
    if "ellipsoidal" in header or re.search(r"height\s*=\s*WGS84/ellipsoidal", text):
        stated = HeightDatum.ELLIPSOIDAL
    elif "orthometric" in header or re.search(r"height\s*=\s*WGS84/geodetic", text):
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


def _read_sigma(values: Mapping[str, str], delimiter: str, layout: PositionFileFormat) -> tuple[PositionSigma, str]:
    """The sigma of a line by its columns, its RTKLIB quality, the portfolio, or assumed; and which of them it is."""
    stated = {
        kind: _parse_number(values.get(kind, ""), delimiter) for kind in ("east", "north", "horizontal", "vertical")
    }
    both = [stated[kind] for kind in ("east", "north") if stated[kind] > 0]
    horizontal_m = max(both) if len(both) == 2 else stated["horizontal"]
    if horizontal_m > 0 and stated["vertical"] > 0:
        sigma = PositionSigma(horizontal_m=horizontal_m, vertical_m=stated["vertical"])
        return sigma, f"stated sigma {sigma.horizontal_m:g}/{sigma.vertical_m:g} m"
    quality = _parse_number(values.get("quality", ""), delimiter)
    if math.isfinite(quality):
        return _SIGMA_BY_QUALITY.get(quality, SIGMA_DRONE), f"quality {quality:g}"
    if layout.sigma is not None:
        return layout.sigma, "sigma of the portfolio"
    return SIGMA_DRONE, f"taken as {SIGMA_DRONE.horizontal_m:g}/{SIGMA_DRONE.vertical_m:g} m"


def _are_equal(priors: Sequence[PositionPrior]) -> bool:
    first = priors[0]
    return all(
        (prior.lon_deg, prior.lat_deg) == (first.lon_deg, first.lat_deg)
        and (prior.height_m == first.height_m or (math.isnan(prior.height_m) and math.isnan(first.height_m)))
        for prior in priors[1:]
    )
