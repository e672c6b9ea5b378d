"""CRS and vertical datum of the portfolio and of an IFC: IfcProjectedCRS, or the property sets of IFC2X3."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import ifcopenshell
import pyproj
from pyproj.exceptions import CRSError

from facadelake.building.model_georeference.ifc_statements import find_crs_entity, read_property_set
from facadelake.core.errors import GeoreferenceError
from facadelake.core.proj.crs_parsing import (
    find_ellipsoidal_heights,
    parse_vertical_datum,
    split_crs,
)


@dataclass(frozen=True, kw_only=True)
class IfcCrs:
    """What the IFC states: name (or WKT, IFC4.3) of the CRS and of the vertical datum, None where not given.

    ``description`` is free text, in which heights may be stated; ``other`` holds GeodeticDatum and MapZone.
    """

    name: str | None
    vertical: str | None
    description: str
    other: Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class ModelCrs:
    """Projected CRS and vertical datum to use; ``remarks`` names statements that were not used."""

    horizontal: str
    vertical: str
    remarks: tuple[str, ...] = ()


def read_crs(model: ifcopenshell.file) -> IfcCrs:
    """Read what the IFC states of its CRS. Raises GeoreferenceError if it states several."""
    entity = find_crs_entity(model)
    if entity is None:
        values = read_property_set(model, "ePSet_ProjectedCRS")
        name = values.get("Name") or read_property_set(model, "ePSet_MapConversion").get("TargetCRS")
    else:
        values = entity.get_info(recursive=False)
        name = values.get("Name")
        wkt = getattr(entity, "WellKnownText", None)
        if wkt:
            name = _choose_name_or_wkt(name, wkt[0].WellKnownText)
    return IfcCrs(
        name=_read_text(name),
        vertical=_read_text(values.get("VerticalDatum")),
        description=_read_text(values.get("Description")) or "",
        other=_read_other(values),
    )


def resolve_crs(map_crs: str | None, vertical_datum: str | None, stated: IfcCrs) -> ModelCrs:
    """Resolve CRS and vertical datum; those of the portfolio replace the IFC's, which are then named in the remarks.

    Args:
        map_crs: the portfolio's projected CRS, which may be compound; None: there is none.
        vertical_datum: the portfolio's vertical datum; None: there is none.
        stated: what the IFC states.

    Returns:
        The CRS and the vertical datum.

    Raises:
        GeoreferenceError: neither states the vertical datum, a CRS is unknown, or the statements of one source differ.
    """
    horizontal, vertical_of_crs = split_crs(map_crs or stated.name or "")
    of_portfolio = [
        (f"crs.vertical: {vertical_datum}", parse_vertical_datum(vertical_datum) if vertical_datum else ""),
        (f"crs.map: {map_crs}", vertical_of_crs if map_crs else ""),
    ]
    vertical = _require_one_datum("the portfolio", of_portfolio)
    of_ifc: list[tuple[str, str]] = []
    try:
        ifc_horizontal, vertical_of_ifc_crs = split_crs(stated.name) if stated.name else ("", "")
        of_ifc = [
            (f"CRS {stated.name}", vertical_of_ifc_crs),
            (f"VerticalDatum {stated.vertical}", parse_vertical_datum(stated.vertical) if stated.vertical else ""),
            (f"Description '{stated.description}'", find_ellipsoidal_heights(stated.description)),
        ]
        ifc_vertical = _require_one_datum("the IFC", of_ifc)
    except GeoreferenceError as error:
        if not (map_crs and vertical):
            raise
        return ModelCrs(horizontal=horizontal, vertical=vertical, remarks=(f"the IFC's CRS was not used, for {error}",))
    remarks = []
    if map_crs and ifc_horizontal and ifc_horizontal != horizontal:
        remarks.append(f"the IFC names the CRS {stated.name}; {horizontal} of the portfolio was used")
    if vertical and ifc_vertical and ifc_vertical != vertical:
        remarks.append(f"the IFC's heights are {ifc_vertical}; {vertical} of the portfolio was used")
    if not map_crs:
        remarks += _check_other(stated.other, horizontal)
    if not (vertical or ifc_vertical):
        unread = f"; its description '{stated.description}' is not used" if stated.description else ""
        raise GeoreferenceError(
            f"neither the IFC nor the portfolio states the vertical datum of the model's heights (CRS {horizontal}"
            f"{unread}); set crs.vertical in the portfolio: 'ellipsoidal', or a vertical CRS such as "
            "EPSG:7837 (DHHN2016)"
        )
    return ModelCrs(horizontal=horizontal, vertical=vertical or ifc_vertical, remarks=tuple(remarks))


def _read_text(value: Any) -> str | None:
    text = str(value).strip() if value is not None else ""
    return text or None


def _read_other(values: Mapping[str, Any]) -> dict[str, str]:
    texts = {name: _read_text(values.get(name)) for name in ("GeodeticDatum", "MapZone")}
    return {name: text for name, text in texts.items() if text}


def _choose_name_or_wkt(name: str | None, wkt: str) -> str:
    """The name if it is a code, else the WKT. Raises GeoreferenceError if both are known and differ."""
    try:
        by_name = pyproj.CRS.from_user_input(name) if name else None
    except CRSError:
        by_name = None
    try:
        by_wkt = pyproj.CRS.from_wkt(wkt)
    except CRSError:
        by_wkt = None
    if by_name is not None and by_wkt is not None and not by_name.equals(by_wkt, ignore_axis_order=True):
        code = by_wkt.to_epsg()
        if code is None or code != by_name.to_epsg():
            raise GeoreferenceError(
                f"the IFC's CRS is named '{name}' ({by_name.name}), but its WellKnownText is that of {by_wkt.name}; "
                "correct one of them, or set crs.map in the portfolio"
            )
    return name if name and (by_name is not None or by_wkt is None) else wkt


def _require_one_datum(source: str, statements: list[tuple[str, str]]) -> str:
    """The vertical datum of the statements (text, datum; "" for none). Raises GeoreferenceError if they differ."""
    given = [(text, datum) for text, datum in statements if datum]
    if len({datum for _, datum in given}) > 1:
        listed = "; ".join(f"{text} ({datum})" for text, datum in given)
        raise GeoreferenceError(
            f"{source} states different vertical datums: {listed}; correct all but one, or set crs.map and "
            "crs.vertical in the portfolio"
        )
    return given[0][1] if given else ""


def _check_other(other: Mapping[str, str], horizontal: str) -> list[str]:
    """Remark on GeodeticDatum. Raises GeoreferenceError if MapZone is not the UTM zone of ``horizontal``."""
    crs = pyproj.CRS.from_user_input(horizontal)
    zone = re.search(r"UTM zone (\d+)", crs.name)
    stated = re.fullmatch(r"(?:UTM)?(?:zone)?\s*0?(\d{1,2})\s*[NS]?", other.get("MapZone", ""), re.IGNORECASE)
    if zone and stated and zone[1] != stated[1]:
        raise GeoreferenceError(
            f"the IFC's CRS is {horizontal} ({crs.name}), but its MapZone is '{other['MapZone']}'; correct one of "
            "them, or set crs.map in the portfolio"
        )
    name = other.get("GeodeticDatum")
    if not name:
        return []
    try:
        datum = pyproj.CRS.from_user_input(name)
    except CRSError:
        return []
    geodetic, of_crs = datum.geodetic_crs, crs.geodetic_crs
    if geodetic is None or of_crs is None or geodetic.name.lower() == of_crs.name.lower():
        return []
    return [f"GeodeticDatum '{name}' is not the datum of {horizontal} ({of_crs.name}), which was used"]
