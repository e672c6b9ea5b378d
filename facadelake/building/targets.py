"""Which elements of a model are parts of the building: an IFC also holds the ground, plants, furniture and vehicles."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import BoolArray

NON_TARGET_CLASSES = frozenset(
    {
        "IfcSite",
        "IfcGeographicElement",
        "IfcEarthworksElement",
        "IfcEarthworksFill",
        "IfcEarthworksCut",
        "IfcPavement",
        "IfcKerb",
        "IfcCourse",
        "IfcSign",
        "IfcVehicle",
        "IfcFurnishingElement",
        "IfcFurniture",
        "IfcSystemFurnitureElement",
    }
)


def mask_target_elements(elements: pa.Table) -> BoolArray:
    """Which elements (n,) of table ``elements`` are parts of the building, where a defect can be."""
    return np.array([name not in NON_TARGET_CLASSES for name in elements.column("ifc_class").to_pylist()], dtype=bool)
