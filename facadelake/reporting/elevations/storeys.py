"""Base level of each storey, from the lower edges of its walls."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from facadelake.building import BuildingModel

_SAME_LEVEL_M = 0.3


@dataclass(frozen=True, kw_only=True)
class StoreyBase:
    """A storey and the level of its walls' lower edges, z in site."""

    name: str
    z_site_m: float


def find_storey_bases(building: BuildingModel) -> list[StoreyBase]:
    """Base levels of the storeys that have elements, from the lowest up.

    The level is the 10th percentile of the lowest points of the storey's walls (of all its elements where it has no
    wall), which is robust against lintels and single deep walls. Storeys at one level, as those of two buildings, are
    one base with both names.
    """
    lowest = np.full(len(building.elements), np.inf)
    bottoms = building.vertices_site_m[building.triangles][:, :, 2].min(axis=1)
    np.minimum.at(lowest, building.element_of_triangle, bottoms)
    names = np.array([name or "" for name in building.elements.column("storey").to_pylist()])
    is_wall = np.array(
        [ifc_class.startswith("IfcWall") for ifc_class in building.elements.column("ifc_class").to_pylist()]
    )
    bases = []
    for name in sorted(set(names) - {""}):
        own = (names == name) & np.isfinite(lowest)
        own = own & is_wall if (own & is_wall).any() else own
        if own.any():
            bases.append(StoreyBase(name=str(name), z_site_m=float(np.quantile(lowest[own], 0.1))))
    bases.sort(key=lambda base: base.z_site_m)
    kept: list[StoreyBase] = []
    for base in bases:
        if not kept or base.z_site_m - kept[-1].z_site_m > _SAME_LEVEL_M:
            kept.append(base)
        else:
            kept[-1] = replace(kept[-1], name=f"{kept[-1].name} / {base.name}")
    return kept
