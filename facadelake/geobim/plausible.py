"""Whether a model's geometry can be a building: its size, and elements that lie far from all others."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from facadelake.core.errors import ModelError
from facadelake.geobim.mesh import ElementMesh

_log = logging.getLogger(__name__)
_STRAY_M = 5_000.0  # from the middle element; float32 rays keep 0.3 mm within it
_HIGHEST_M = 1_200.0  # no building is higher
_SMALLEST_M = 0.5


def without_strays(meshes: Sequence[ElementMesh]) -> tuple[list[ElementMesh], str]:
    """The meshes without those more than 5 km from the middle one, and words about what was left out.

    Such elements are left at the file's zero, or at map coordinates, by mistake. Raises ModelError where what is left
    is too large or too small for a building, so that its unit is wrong.
    """
    middles = np.array([(mesh.vertices_ifc_m.min(axis=0) + mesh.vertices_ifc_m.max(axis=0)) / 2 for mesh in meshes])
    off = np.linalg.norm(middles - np.median(middles, axis=0), axis=1)
    kept = [mesh for mesh, far in zip(meshes, off > _STRAY_M, strict=True) if not far]
    strays = [mesh.guid for mesh, far in zip(meshes, off > _STRAY_M, strict=True) if far]
    if len(strays) > len(meshes) / 2:
        raise ModelError(
            f"the elements of the building model lie up to {off.max() / 1000:.0f} km apart; is its length unit wrong, "
            "or are some at map coordinates and others at zero? export it again"
        )
    size = np.ptp(np.vstack([mesh.vertices_ifc_m for mesh in kept]), axis=0)
    if size[2] > _HIGHEST_M or size.max() < _SMALLEST_M:
        raise ModelError(
            f"the building model is {size[0]:.3g} x {size[1]:.3g} m in plan and {size[2]:.3g} m high, which no "
            "building is; its length unit (IfcUnitAssignment) is wrong: export it again"
        )
    if not strays:
        return kept, ""
    named = ", ".join(strays[:5]) + (" ..." if len(strays) > 5 else "")
    said = f"{len(strays)} elements more than {_STRAY_M / 1000:g} km from the others were left out ({named})"
    _log.warning("%s", said)
    return kept, said
