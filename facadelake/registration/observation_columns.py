"""Patches as columns of table ``observations``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from facadelake.building import BuildingModel, find_storeys
from facadelake.building.facades import collect_facades
from facadelake.core.arrays import Float64Array, Int64Array
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
    """Where patches on ``building`` are: on the globe, on the map, and on which element, storey and facade."""

    def __init__(self, building: BuildingModel, attribution: ElementAttribution) -> None:
        self._building = building
        self._attribution = attribution
        self._extents = building.compute_vertical_extents()
        self._facade_directions = collect_facades(building.elements)
        self._guids, self._storeys, self._facades = (
            building.elements.column(name).to_pylist() for name in ("element_guid", "storey", "facade")
        )

    def build(self, casts: RaycastBatch, kept: Int64Array, covariance_site: Float64Array) -> dict[str, Sequence[Any]]:
        """Columns of the detections ``kept`` (m,), all of which met the building; ``covariance_site`` (m, 3, 3)."""
        patches, building = casts.patches, self._building
        xyz, normal = patches.xyz_site_m[kept], patches.normal_site[kept]
        geo = building.origin.geo_from_site(xyz)
        element = self._attribution.attribute_patches(casts.outlines, casts.hits, patches.member)[kept]
        focal = np.array(
            [np.sqrt(camera.camera.fx_px * camera.camera.fy_px) for camera in casts.cameras], dtype=np.float64
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
            "gsd_mm": (1000 * depth / focal[casts.camera_index[kept]]).tolist(),
            "width_m": patches.width_m[kept].tolist(),
            "height_m": patches.height_m[kept].tolist(),
            "length_m": patches.length_m[kept].tolist(),
            "area_m2": patches.area_m2[kept].tolist(),
            **compute_crack_columns(casts, kept, covariance_site),
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
    return {name: column.tolist() for name, column in zip(names, values.T, strict=True)}
