"""CRS and vertical datum that an IFC file names: IfcProjectedCRS, or the property sets of IFC2X3."""

from __future__ import annotations

import ifcopenshell

from facadelake.building.model_georeference.crs_parsing import ELLIPSOIDAL
from facadelake.building.model_georeference.map_conversion import find_crs_entity, read_property_set


def read_crs(model: ifcopenshell.file) -> tuple[str | None, str | None]:
    """Read the name (or WKT, IFC4.3) of the CRS and the vertical datum; None where not given."""
    entity = find_crs_entity(model)
    if entity is None:
        values = read_property_set(model, "ePSet_ProjectedCRS")
        name = values.get("Name") or read_property_set(model, "ePSet_MapConversion").get("TargetCRS")
    else:
        values = entity.get_info(recursive=False)
        name = values.get("Name")
        wkt = getattr(entity, "WellKnownText", None)
        if wkt and not (name and ":" in name):
            name = wkt[0].WellKnownText
    vertical = values.get("VerticalDatum")
    if not vertical and "ellipsoid" in str(values.get("Description") or "").lower():
        vertical = ELLIPSOIDAL
    return name or None, vertical or None
