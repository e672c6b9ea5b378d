"""The columns of a positions file: what each is, by its name in the header or in the portfolio, and its unit."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from facadelake.core.errors import InputDataError

_COLUMNS: dict[str, str] = {
    **dict.fromkeys(
        ("name", "image", "imagename", "filename", "file", "photo", "photoid", "photograph", "label", "sourcefile"),
        "name",
    ),
    **dict.fromkeys(("latitude", "lat", "latdeg", "latitudedeg", "gpslatitude"), "lat"),
    **dict.fromkeys(("longitude", "lon", "long", "lng", "londeg", "longitudedeg", "gpslongitude"), "lon"),
    **dict.fromkeys(
        (
            *("ellipsoidalheight", "ellipsoidheight", "heightellipsoidal", "altellipsoidal", "altitudeellipsoidal"),
            *("ellipsoidalaltitude", "ellipsoidalalt", "hell", "hae", "heighthae", "altitudehae", "althae"),
            *("altwgs84", "altitudewgs84", "heightwgs84"),
        ),
        "ellipsoidal",
    ),
    **dict.fromkeys(
        (
            *("orthometricheight", "heightorthometric", "orthometricaltitude", "orthometric", "orthoheight"),
            *("msl", "amsl", "hmsl", "altmsl", "altitudemsl", "heightmsl", "elevationmsl", "mslaltitude", "mslheight"),
            *("altamsl", "altitudeamsl", "heightamsl"),
        ),
        "orthometric",
    ),
    **dict.fromkeys(("height", "altitude", "alt", "elevation", "elev", "z", "gpsaltitude"), "height"),
    **dict.fromkeys(
        (
            *("accuracyhorizontal", "horizontalaccuracy", "accuracyhorz", "horzaccuracy", "sigmahorizontal", "sigmah"),
            *("gpsxyaccuracy", "xyaccuracy", "accuracyxy", "lateralrms", "hacc", "haccuracy", "hrms"),
        ),
        "horizontal",
    ),
    **dict.fromkeys(("sde", "eastingrms", "sigmaeast", "sigmae", "stde", "stdeast", "stdlon", "rtkstdlon"), "east"),
    **dict.fromkeys(("sdn", "northingrms", "sigmanorth", "sigman", "stdn", "stdnorth", "stdlat", "rtkstdlat"), "north"),
    **dict.fromkeys(
        (
            *("sdu", "elevationrms", "accuracyvertical", "verticalaccuracy", "accuracyvert", "vertaccuracy"),
            *("sigmavertical", "sigmav", "sigmaup", "sigmau", "stdu", "stdup", "stdhgt", "rtkstdhgt"),
            *("gpszaccuracy", "zaccuracy", "accuracyz", "vacc", "vaccuracy", "vrms"),
        ),
        "vertical",
    ),
    "q": "quality",  # RTKLIB's; "quality" may be NMEA's (1: no corrections) or that of the picture
    **dict.fromkeys(("gpslatituderef", "latituderef", "latref", "latitudehemisphere", "lathemisphere"), "lat_ref"),
    **dict.fromkeys(("gpslongituderef", "longituderef", "lonref", "longitudehemisphere", "lonhemisphere"), "lon_ref"),
    **dict.fromkeys(("gpsaltituderef", "altituderef", "altref"), "height_ref"),
}
# North or south, east or west, where all values are such letters: RTKLIB's "ns" is the number of satellites.
_BY_LETTERS = {"ns": ("lat_ref", {"n", "s", "north", "south"}), "ew": ("lon_ref", {"e", "w", "east", "west"})}
_REQUIRED = {"name": "photograph", "lat": "latitude", "lon": "longitude"}
HEIGHTS = ("ellipsoidal", "orthometric", "height")
SIGMAS = ("horizontal", "east", "north", "vertical")
_UNIT_ENDING = re.compile(r"(.*?)[ _-]*(us-?ft|us-?feet|ft|feet|foot|mm|cm|km|rad|dms|m)\s*")
_UNITS = ("", "deg", "degrees", "°", "decimal degrees", "dd", "m", "metre", "metres", "meter", "meters", "wgs84")
_SIGMA_UNITS = {"mm": 0.001, "cm": 0.01}
_TIME_COLUMNS = ("gpst", "utc", "jst")  # RTKLIB writes date and time as two columns under one of these names
# Names of columns that may be heights or accuracies, for those that are not recognised.
_LIKE_HEIGHT = re.compile(r"alt|height|hgt|hoehe|höhe|elev|msl|ellips")
_LIKE_SIGMA = re.compile(r"sigma|std|acc|rms|error|quality|sd[a-z]?$")
_NOT_LIKE = re.compile(r"antenna|sd(ne|eu|un)|solution|status|units?$")


@dataclass(frozen=True, kw_only=True)
class PositionLine:
    """A line of a positions file with its number and its fields."""

    number: int
    text: str
    fields: Sequence[str]


@dataclass(frozen=True, kw_only=True)
class PositionColumns:
    """The columns and lines of a positions file.

    ``count`` is their number, ``index`` is the column of each kind and ``names`` its name; ``sigma_factor`` converts
    accuracies to metres by the kind of their column, 1 where it states no unit, which ``states_unit`` then lacks.
    ``unrecognised`` are names of columns that may be heights or accuracies, where the file has no others.
    """

    count: int
    index: Mapping[str, int]
    names: Mapping[str, str]
    sigma_factor: Mapping[str, float]
    states_unit: frozenset[str]
    unrecognised: tuple[str, ...]
    delimiter: str
    lines: Sequence[PositionLine]

    def get_values(self, line: PositionLine) -> dict[str, str]:
        """The fields of a line by kind of column; empty where it has none."""
        return {kind: line.fields[i].strip() if i < len(line.fields) else "" for kind, i in self.index.items()}


def read_columns(path: Path, text: str, columns: Sequence[str]) -> PositionColumns:
    """Columns and lines of a positions file; its header may be a comment, as RTKLIB writes it.

    Args:
        path: the file, for messages.
        text: its content.
        columns: names of its columns where it has no header, as the portfolio gives them.

    Returns:
        the columns and the lines of data.

    Raises:
        InputDataError: the file is empty, or a column is missing, there twice or in another unit.
    """
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    data = [(number, line) for number, line in lines if line.lstrip()[0] not in "#%"]
    names: Sequence[str] = columns
    delimiter = _choose_delimiter(data[0][1] if data else "")
    if not names:
        names = _find_commented_header([line.lstrip("#% ") for _, line in lines if line.lstrip()[0] in "#%"])
    if not names:
        if not data:
            raise InputDataError(f"the positions file {path} is empty")
        names, data = _split_line(data[0][1], delimiter), data[1:]
    rows = [
        PositionLine(number=number, text=line.strip(), fields=_split_line(line, delimiter)) for number, line in data
    ]
    return _index_columns(path, names, rows, delimiter)


def _choose_delimiter(line: str) -> str:
    return next((delimiter for delimiter in "\t;," if delimiter in line), " ")


def _split_line(line: str, delimiter: str) -> list[str]:
    fields = next(csv.reader([line.strip()], delimiter=delimiter, skipinitialspace=True))
    return [field.strip() for field in fields if field.strip() or delimiter != " "]


def _simplify(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _find_commented_header(comments: Sequence[str]) -> list[str]:
    """The names of the columns in the last comment that is a header; empty where none is."""
    for line in reversed(comments):
        delimiter = _choose_delimiter(line)
        names = _split_line(line, delimiter)
        if sum(bool(_COLUMNS.get(_simplify(name.split("(")[0]))) for name in names) > 1:
            if delimiter == " ":
                names = [part for name in names for part in ([name, name] if name.lower() in _TIME_COLUMNS else [name])]
            return names
    return []


def _name_column(text: str) -> tuple[str, str]:
    """Kind and unit of a column by its name; empty where it is none of those used. Raises ValueError: a unit."""
    name, unit = text.lower(), ""
    found = re.fullmatch(r"(.*?)[\[(]([^\])]*)[\])]?\s*", name)
    if found:
        name, unit = found[1], found[2].strip()
    kind = _COLUMNS.get(_simplify(name), "")
    ending = _UNIT_ENDING.fullmatch(name)
    if ending and not kind:
        kind, unit = _COLUMNS.get(_simplify(ending[1]), ""), ending[2]
    if kind and unit not in _UNITS and not (kind in SIGMAS and unit in _SIGMA_UNITS):
        raise ValueError(f"column '{text}' is in {unit}; give degrees and metres")
    return kind, unit


def _index_columns(path: Path, names: Sequence[str], rows: Sequence[PositionLine], delimiter: str) -> PositionColumns:
    """The columns by kind.

    Args:
        path: the file, for messages.
        names: the names of its columns.
        rows: its lines of data.
        delimiter: what separates its columns.

    Returns:
        the columns.

    Raises:
        InputDataError: a column is missing, there twice, or in another unit.
    """
    index: dict[str, int] = {}
    named: dict[str, str] = {}
    units: dict[str, str] = {}
    others: list[str] = []
    try:
        for i, name in enumerate(names):
            kind, unit = _name_column(name)
            by_letters, letters = _BY_LETTERS.get(_simplify(name), ("", set()))
            values = {row.fields[i].strip().lower() for row in rows if i < len(row.fields)} - {""}
            if by_letters and values and values <= letters:
                kind = by_letters
            if kind in index:
                raise ValueError(f"two columns are the {kind}")
            if kind:
                index[kind], named[kind], units[kind] = i, name, unit
            else:
                others.append(name)
    except ValueError as error:
        raise InputDataError(f"the positions file {path}: {error}") from error
    missing = [word for kind, word in _REQUIRED.items() if kind not in index]
    if missing:
        raise InputDataError(
            f"the positions file {path} has no column of {' and '.join(missing)}; give a header such as "
            "'name,latitude,longitude,ellipsoidal height,sigma_horizontal_m,sigma_vertical_m', or name the columns in "
            "the portfolio (positions: {file, columns})"
        )
    wanted = [
        *([] if any(kind in index for kind in HEIGHTS) else [_LIKE_HEIGHT]),
        *([] if any(kind in index for kind in SIGMAS) else [_LIKE_SIGMA]),
    ]
    return PositionColumns(
        count=len(names),
        index=index,
        names=named,
        sigma_factor={kind: _SIGMA_UNITS.get(units[kind], 1.0) for kind in SIGMAS if kind in index},
        states_unit=frozenset(kind for kind in index if units[kind]),
        unrecognised=tuple(
            name
            for name in others
            if any(like.search(name.lower()) for like in wanted) and not _NOT_LIKE.search(name.lower())
        ),
        delimiter=delimiter,
        lines=rows,
    )
