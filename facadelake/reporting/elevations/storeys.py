"""Where the storeys begin, read off the model's walls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.building import BuildingModel

_SAME_LEVEL_M = 0.3


@dataclass(frozen=True, kw_only=True)
class StoreyBase:
    """A storey and the height of its walls' feet, ``z`` of site."""

    name: str
    z_site_m: float


def find_storey_bases(building: BuildingModel) -> list[StoreyBase]:
    """Storeys that have elements, from the lowest up.

    The level is the low tenth of the lowest points of the storey's walls (of any element where it has no wall), so
    that neither a lintel nor one wall with a deep foot decides. Where two storeys share a level, the first is named.
    """
    lowest = np.full(len(building.elements), np.inf)
    bottoms = building.vertices_site_m[building.triangles][:, :, 2].min(axis=1)
    np.minimum.at(lowest, building.element_of_triangle, bottoms)
    names = np.array([name or "" for name in building.elements.column("storey").to_pylist()])
    is_wall = np.array([word.startswith("IfcWall") for word in building.elements.column("ifc_class").to_pylist()])
    levels = []
    for name in sorted(set(names) - {""}):
        own = (names == name) & np.isfinite(lowest)
        own = own & is_wall if (own & is_wall).any() else own
        if own.any():
            levels.append(StoreyBase(name=str(name), z_site_m=float(np.quantile(lowest[own], 0.1))))
    levels.sort(key=lambda level: level.z_site_m)
    kept: list[StoreyBase] = []
    for level in levels:
        if not kept or level.z_site_m - kept[-1].z_site_m > _SAME_LEVEL_M:
            kept.append(level)
    return kept
