"""Positions and patches as columns of table ``observations``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from facadelake.building import BuildingModel, find_storeys
from facadelake.building.facades import collect_facades
from facadelake.core.arrays import Float64Array, Float64Nx3x3, RowIndices
from facadelake.registration.attribution import ElementAttribution
from facadelake.registration.crack_widths import compute_crack_columns
from facadelake.registration.patch import convert_patches_to_wkb
from facadelake.registration.raycast import RaycastBatch

_SITE = ("x_site_m", "y_site_m", "z_site_m")
_GEO = ("lon_deg", "lat_deg", "height_ellipsoidal_m")
_MAP = ("east_map_m", "north_map_m", "height_map_m")
_NORMAL = ("normal_x", "normal_y", "normal_z")
_SIGMA = ("sigma_east_m", "sigma_north_m", "sigma_up_m")


class ObservationColumns:
    """Builds the columns of positions on ``building``: coordinates, extents, element, storey, facade, crack widths."""

    def __init__(self, building: BuildingModel, attribution: ElementAttribution) -> None:
        self._building = building
        self._attribution = attribution
        self._extents = building.compute_vertical_extents()
        self._facade_directions = collect_facades(building.elements)
        self._guids, self._storeys, self._facades = (
            building.elements.column(name).to_pylist() for name in ("element_guid", "storey", "facade")
        )

    def build(self, batch: RaycastBatch, kept: RowIndices, covariance_site: Float64Nx3x3) -> dict[str, Sequence[Any]]:
        """Columns of the detections ``kept`` (m,), all of which hit the building.

        ``covariance_site`` (m, 3, 3): covariances of their positions in m2.
        """
        patches, building = batch.patches, self._building
        xyz, normal = patches.xyz_site_m[kept], patches.normal_site[kept]
        geo = building.origin.geo_from_site(xyz)
        element = self._attribution.attribute_patches(batch.outlines, batch.hits, patches.member)[kept]
        focal = np.array(
            [np.sqrt(camera.camera.fx_px * camera.camera.fy_px) for camera in batch.cameras], dtype=np.float64
        )
        depth = patches.distance_m[kept] * patches.ray.forward_cosine[kept]
        return {
            **_split_axes(_SITE, xyz),
            **_split_axes(_GEO, geo),
            **_split_axes(_MAP, building.map_from_site(xyz)),
            **_split_axes(_NORMAL, normal),
            **_split_axes(_SIGMA, np.sqrt(np.einsum("nii->ni", covariance_site))),
            "covariance_site": covariance_site.reshape(-1, 9).tolist(),
            "incidence_deg": patches.incidence_deg[kept].tolist(),
            "distance_m": patches.distance_m[kept].tolist(),
            "gsd_mm": (1000 * depth / focal[batch.camera_index[kept]]).tolist(),
            "width_m": patches.width_m[kept].tolist(),
            "height_m": patches.height_m[kept].tolist(),
            "length_m": patches.length_m[kept].tolist(),
            "area_m2": patches.area_m2[kept].tolist(),
            **compute_crack_columns(batch, kept, covariance_site),
            "element_guid": [self._guids[row] for row in element],
            "storey": find_storeys(building.storeys, self._storeys, self._extents, element, xyz[:, 2]),
            "facade": [
                self._facade_directions.assign_facade(self._facades[row], facing)
                for row, facing in zip(element, normal, strict=True)
            ],
            "patch": convert_patches_to_wkb(patches.polygon_site[kept], building.origin),
            "geometry": shapely.to_wkb(shapely.points(geo), output_dimension=3).tolist(),
        }


def _split_axes(names: Sequence[str], values: Float64Array) -> dict[str, Sequence[Any]]:
    """The columns of ``values`` (n, k) by their names."""
    return {name: column.tolist() for name, column in zip(names, values.T, strict=True)}
