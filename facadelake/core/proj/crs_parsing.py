"""Projected CRS and vertical datum, parsed from names and codes with PROJ's database."""

from __future__ import annotations

import re

import pyproj
from pyproj.database import get_codes, query_crs_info
from pyproj.enums import PJType
from pyproj.exceptions import CRSError

from facadelake.core.errors import GeoreferenceError
from facadelake.core.proj.crs import ELLIPSOID_OF_CRS, ELLIPSOIDAL

# A datum that is stated as an ellipsoid, by its whole text: "reference ellipsoid GRS80, heights DHHN92" is not.
_ELLIPSOID = r"(?:grs ?(?:19)?80|wgs ?(?:19)?84|etrs ?(?:19)?89)"
_ELLIPSOIDAL = re.compile(
    rf"(?:ellipsoid(?:al|ic)?(?: heights?)?(?:,? ?(?:of |on |over |above )?\(?(?:the )?{_ELLIPSOID}(?: ellipsoid)?\)?)?"
    rf"|{_ELLIPSOID}(?: ellipsoid(?:al)?(?: heights?)?)?)",
    re.IGNORECASE,
)
_HEIGHT_STATEMENT = re.compile(
    rf"(?:all )?heights?(?: are| is|:| =)? ?(?:{_ELLIPSOIDAL.pattern})"
    rf"|(?=ellipsoid(?:al|ic) heights?){_ELLIPSOIDAL.pattern}",
    re.IGNORECASE,
)
_MENTIONS_HEIGHT = re.compile(
    r"height|vertical|geoid|orthometric|elevation|level|ellipsoid(?:al|ic)|convert|reduce|correct|transform|\b(?:nhn|nn|a?msl)\b",
    re.IGNORECASE,
)
_GNSS_ELLIPSOIDS = ("WGS 84", "GRS 1980")
_CODE = re.compile(r"^(?:urn:ogc:def:crs:)?EPSG:{1,2}(\d+)$|^(\d{4,5})$", re.IGNORECASE)


def split_crs(crs_text: str) -> tuple[str, str]:
    """Split a CRS into its projected part and its vertical datum ("" if it has none).

    A compound CRS ("EPSG:25832+7837", "EPSG:5555") has both; one with three axes has ellipsoidal heights. Raises
    GeoreferenceError for a CRS that PROJ does not know or that is not projected.
    """
    try:
        crs = pyproj.CRS.from_user_input(crs_text)
    except CRSError as error:
        raise GeoreferenceError(
            f"CRS '{crs_text}' is not known to PROJ; set crs.map in the portfolio to an EPSG code such as EPSG:25832"
        ) from error
    horizontal = crs.sub_crs_list[0] if crs.is_compound else crs
    if not horizontal.is_projected:
        raise GeoreferenceError(
            f"CRS '{crs_text}' ({horizontal.name}) is not a projected CRS, which a map conversion requires; set "
            "crs.map in the portfolio to an EPSG code such as EPSG:25832"
        )
    vertical = ""
    if crs.is_compound:
        vertical = _format_crs(crs.sub_crs_list[1])
    elif len(crs.axis_info) == 3:
        modern = crs.ellipsoid is not None and crs.ellipsoid.name in _GNSS_ELLIPSOIDS
        vertical = ELLIPSOIDAL if modern else ELLIPSOID_OF_CRS
    return _format_crs(horizontal), vertical


def parse_vertical_datum(text: str) -> str:
    """Parse a code or a name such as "DHHN2016" or "NAVD88 height" into "ellipsoidal" or "EPSG:<code>".

    Raises GeoreferenceError if PROJ knows no such vertical CRS, or more than one.
    """
    name = text.strip()
    if name.lower() == ELLIPSOID_OF_CRS.lower():
        return ELLIPSOID_OF_CRS
    if _ELLIPSOIDAL.fullmatch(name):
        return ELLIPSOIDAL
    code = _CODE.match(name)
    if code and (code[1] or code[2]) in get_codes("EPSG", PJType.CRS, allow_deprecated=True):
        crs = pyproj.CRS.from_epsg(int(code[1] or code[2]))
        if crs.is_vertical:
            return f"EPSG:{crs.to_epsg()}"
        raise GeoreferenceError(
            f"{name} ({crs.name}) is not a vertical CRS; use one such as EPSG:7837 (DHHN2016 height)"
        )
    known = query_crs_info(auth_name="EPSG", pj_types=[PJType.VERTICAL_CRS])
    same = [info for info in known if info.name.lower() in (name.lower(), f"{name.lower()} height")]
    if len(same) != 1:
        raise GeoreferenceError(
            f"PROJ knows no single vertical CRS named '{text}'; set crs.vertical in the portfolio: 'ellipsoidal', or a "
            "vertical CRS such as EPSG:7837 (DHHN2016)"
        )
    return f"EPSG:{same[0].code}"


def find_ellipsoidal_heights(description: str) -> str:
    """ "ellipsoidal" if a clause of the description states it of the heights; "" if none does, or others mention them.

    Clauses end at a comma, a semicolon, a full stop or a new line. "ETRS89 / UTM zone 32N; heights are ellipsoidal"
    states it; "reference ellipsoid GRS80, heights DHHN92" does not.
    """
    clauses = [clause.strip() for clause in re.split(r"[,;\n]|\.(?:\s|$)", description) if clause.strip()]
    statements = [clause for clause in clauses if _HEIGHT_STATEMENT.fullmatch(clause)]
    others = [clause for clause in clauses if clause not in statements]
    if not statements or any(_MENTIONS_HEIGHT.search(clause) or _is_vertical_crs(clause) for clause in others):
        return ""
    return ELLIPSOIDAL


def _is_vertical_crs(text: str) -> bool:
    try:
        return parse_vertical_datum(text) != ELLIPSOIDAL
    except GeoreferenceError:
        return False


def _format_crs(crs: pyproj.CRS) -> str:
    """Format as EPSG code, or as WKT if there is none."""
    code = crs.to_epsg()
    return f"EPSG:{code}" if code else str(crs.to_wkt())
