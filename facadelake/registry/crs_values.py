"""CRSs named in the portfolio: known to PROJ, and of the kind that the key wants.

PROJ is imported where a portfolio names a CRS: commands that do not need it start faster.
"""

from __future__ import annotations

from facadelake.core.errors import GeoreferenceError


def check_map_crs(text: str) -> str:
    """The projected CRS as given. Raises ValueError where PROJ does not know it, or it is of another kind."""
    from facadelake.core.proj.crs_parsing import split_crs

    try:
        split_crs(text)
    except GeoreferenceError as error:
        raise ValueError(str(error)) from error
    return text


def check_vertical_datum(text: str) -> str:
    """The vertical datum as given. Raises ValueError where it is neither a vertical CRS nor ``ellipsoidal``."""
    from facadelake.core.proj.crs_parsing import parse_vertical_datum

    try:
        parse_vertical_datum(text)
    except GeoreferenceError as error:
        raise ValueError(str(error)) from error
    return text


def check_gnss_crs(text: str) -> str:
    """The geographic CRS as given. Raises ValueError where PROJ does not know it, or it is of another kind."""
    from facadelake.core.proj.crs import get_crs_name, parse_crs

    expected = "a geographic CRS such as EPSG:4258 (ETRS89) or EPSG:6318 (NAD83(2011)) is expected"
    try:
        crs = parse_crs(text)
    except GeoreferenceError as error:
        raise ValueError(f"not known to PROJ; {expected}") from error
    if not crs.is_geographic or crs.is_compound:
        raise ValueError(f"{get_crs_name(crs)} is not a geographic CRS; {expected}")
    return text


def check_one_vertical_datum(map_crs: str, vertical: str) -> None:
    """Raise ValueError where a compound CRS has other heights than ``vertical``."""
    from facadelake.core.proj.crs_parsing import parse_vertical_datum, split_crs

    own = split_crs(map_crs)[1]
    if own and own != parse_vertical_datum(vertical):
        raise ValueError(f"'map' {map_crs} has heights in {own}, 'vertical' is {vertical}; give one of them")
