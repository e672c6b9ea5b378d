"""What heights refer to: the ellipsoid or a vertical CRS, by name or by code."""

from __future__ import annotations

import re

import pyproj
from pyproj.database import get_codes, query_crs_info
from pyproj.enums import PJType
from pyproj.exceptions import CRSError

from facadelake.core.errors import GeoreferenceError

ELLIPSOIDAL = "ellipsoidal"
_ELLIPSOIDS = {"ellipsoid", "ellipsoidal", "grs80", "grs 80", "grs1980", "grs 1980", "wgs84", "wgs 84", "etrs89"}
_CODE = re.compile(r"^(?:urn:ogc:def:crs:)?EPSG:{1,2}(\d+)$|^(\d{4,5})$", re.IGNORECASE)


def split_crs(crs_text: str) -> tuple[str, str]:
    """A CRS as its horizontal part and what it says of heights ("" where it says nothing).

    A compound CRS ("EPSG:25832+7837", "EPSG:5555") falls into its two parts; one with three axes has ellipsoidal
    heights. Raises GeoreferenceError for a CRS that PROJ does not know or that is not projected.
    """
    try:
        crs = pyproj.CRS.from_user_input(crs_text)
    except CRSError as error:
        raise GeoreferenceError(
            f"CRS '{crs_text}' is not known to PROJ; give the registry's crs.map an EPSG code such as EPSG:25832"
        ) from error
    horizontal = crs.sub_crs_list[0] if crs.is_compound else crs
    if not horizontal.is_projected:
        raise GeoreferenceError(
            f"CRS '{crs_text}' ({horizontal.name}) is not a projected CRS in metres or feet, which a map conversion "
            "needs; give the registry's crs.map an EPSG code such as EPSG:25832"
        )
    vertical = ""
    if crs.is_compound:
        vertical = _format_crs(crs.sub_crs_list[1])
    elif len(crs.axis_info) == 3:
        vertical = ELLIPSOIDAL
    return _format_crs(horizontal), vertical


def parse_vertical_datum(text: str) -> str:
    """A vertical datum as "ellipsoidal" or "EPSG:<code>", from a code or a name such as "DHHN2016" or "NAVD88 height".

    Raises GeoreferenceError where PROJ knows no such vertical CRS, or more than one.
    """
    word = text.strip()
    if word.lower() in _ELLIPSOIDS or "ellipsoid" in word.lower():
        return ELLIPSOIDAL
    code = _CODE.match(word)
    if code and (code[1] or code[2]) in get_codes("EPSG", PJType.CRS, allow_deprecated=True):
        crs = pyproj.CRS.from_epsg(int(code[1] or code[2]))
        if crs.is_vertical:
            return f"EPSG:{crs.to_epsg()}"
        raise GeoreferenceError(
            f"{word} ({crs.name}) is not a vertical CRS; give one such as EPSG:5783 (DHHN92 height)"
        )
    known = query_crs_info(auth_name="EPSG", pj_types=[PJType.VERTICAL_CRS])
    same = [info for info in known if info.name.lower() in (word.lower(), f"{word.lower()} height")]
    if len(same) != 1:
        raise GeoreferenceError(
            f"the vertical datum '{text}' is not one that PROJ knows by that name; give the registry's crs.vertical: "
            "'ellipsoidal', or a vertical CRS such as EPSG:5783 (DHHN92)"
        )
    return f"EPSG:{same[0].code}"


def _format_crs(crs: pyproj.CRS) -> str:
    code = crs.to_epsg()
    return f"EPSG:{code}" if code else str(crs.to_wkt())
