"""Readings of a mesh file: which axis is up, and its unit; told, and checked against the photographs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from facadelake.building.mesh.files import MeshAxes, turn_y_up, turn_z_up
from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import BoolArray, Float64N, Float64Nx3, Int64Nx3
from facadelake.core.errors import GeoreferenceError
from facadelake.registry import UNITS_M
from schemas.vocabulary import HeightDatum

# Another reading is better if nearly all photographs fit it, and clearly more than the one taken.
_MIN_FIT_SHARE, _MIN_GAIN = 0.8, 0.25
_MIN_PHOTOGRAPHS, _MAX_PHOTOGRAPHS = 5, 100
_SAMPLES = 400  # points of the surface
_LOOK_TOLERANCE_DEG = 5.0  # attitudes of gimbals are better than this
_UNKNOWN_DATUM_M = np.arange(-80.0, 81.0, 5.0)  # geoid heights are up to 85 m; barometric ones deviate by less


@dataclass(frozen=True, kw_only=True)
class MeshReading:
    """A mesh file's upward axis, and the name of its unit."""

    axes: MeshAxes
    unit: str

    def __str__(self) -> str:
        return f"crs.axes: {self.axes}, crs.unit: {self.unit}"

    def read_vertices(self, vertices_m: Float64Nx3, taken: MeshReading) -> Float64Nx3:
        """Vertices (n, 3), z up, metres, by this reading of a file whose vertices ``taken`` reads as ``vertices_m``."""
        if self.axes is not taken.axes:
            vertices_m = turn_y_up(vertices_m) if self.axes is MeshAxes.Y_UP else turn_z_up(vertices_m)
        return vertices_m * (UNITS_M[self.unit] / UNITS_M[taken.unit])


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotographRays:
    """Where n photographs were taken and looked, by their own metadata.

    ``geo`` (n, 3) is EPSG:4979; heights of an unknown datum are those of the file. ``direction`` (n, 3) is the axis of
    view (east, north, up; unit), NaN where unknown; ``sigma_m`` (n,) the sigma of the position.
    """

    geo: Float64Nx3
    direction: Float64Nx3
    sigma_m: Float64N
    has_datum: BoolArray


def list_other_readings(taken: MeshReading, *, axes: MeshAxes | None, unit: str | None) -> list[MeshReading]:
    """The other readings of a mesh that the portfolio leaves open: ``axes`` and ``unit`` are its keys, if set."""
    readings = [
        MeshReading(axes=up, unit=name)
        for up in ([axes] if axes else MeshAxes)
        for name in ([unit] if unit else UNITS_M)
        if unit or name != "us_survey_foot"  # at the size of a building it is a foot
    ]
    return [reading for reading in readings if reading != taken]


def describe_reading(taken: MeshReading, vertices_m: Float64Nx3, *, axes: MeshAxes | None, unit: str | None) -> str:
    """Remark on the axis and unit with which a mesh was read, and on its size by them.

    Args:
        taken: the reading.
        vertices_m: the vertices (n, 3), z up.
        axes: the portfolio's ``crs.axes``, if set.
        unit: the portfolio's ``crs.unit``, if set.
    """
    size = np.ptp(vertices_m, axis=0)
    up = taken.axes.replace("-", " ")
    by_axes = "by crs.axes" if axes else "crs.axes is not set"
    by_unit = "by crs.unit" if unit else "crs.unit is not set"
    return (
        f"the mesh was read with {up} ({by_axes}) and {taken.unit} as its unit ({by_unit}): it is {size[0]:.1f} x "
        f"{size[1]:.1f} m in plan and {size[2]:.1f} m high"
    )


def require_reading_fits(
    taken: MeshReading,
    others: list[MeshReading],
    vertices_m: Float64Nx3,
    triangles: Int64Nx3,
    site_from_mesh: Callable[[Float64Nx3], Float64Nx3],
    rays_site: PhotographRays,
) -> None:
    """Refuse a reading that the photographs do not fit, where they fit another.

    A photograph fits if it was not taken inside the building, and, where its attitude is known, looks at it.

    Args:
        taken: the reading.
        others: the readings that the portfolio leaves open.
        vertices_m: the vertices (n, 3), z up, as ``taken`` reads them.
        triangles: rows of the vertices (m, 3).
        site_from_mesh: transforms vertices to site.
        rays_site: the photographs, ``geo`` in site.

    Raises:
        GeoreferenceError: another reading fits better; names the keys of the portfolio.
    """
    if len(rays_site.geo) < _MIN_PHOTOGRAPHS:
        return
    share = _compute_share(site_from_mesh(vertices_m), triangles, rays_site)
    if share > 1 - _MIN_GAIN:
        return
    shares = [
        (_compute_share(site_from_mesh(one.read_vertices(vertices_m, taken)), triangles, rays_site), one)
        for one in others
    ]
    best_share, best = max(shares, key=lambda pair: pair[0], default=(0.0, taken))
    if best_share < max(_MIN_FIT_SHARE, share + _MIN_GAIN):
        return
    size, other_size = np.ptp(vertices_m, axis=0), np.ptp(best.read_vertices(vertices_m, taken), axis=0)
    raise GeoreferenceError(
        f"read with {taken}, the mesh is {size[0]:.1f} x {size[1]:.1f} x {size[2]:.1f} m, and {share:.0%} of "
        f"{len(rays_site.geo)} photographs stand outside it and look at it by their own metadata; read with {best}, it "
        f"is {other_size[0]:.1f} x {other_size[1]:.1f} x {other_size[2]:.1f} m, and {best_share:.0%} do (limit: "
        f"{_MIN_GAIN:.0%} more): set crs.axes and crs.unit in the portfolio"
    )


def read_photograph_rays(photos: pa.Table) -> PhotographRays:
    """The positions and axes of view of table ``photos``, of at most 100 photographs."""
    names = ("prior_lon_deg", "prior_lat_deg", "prior_height_m", "prior_sigma_horizontal_m")
    lon, lat, height, sigma = (photos.column(name).to_numpy(zero_copy_only=False).astype(float) for name in names)
    yaw, pitch = (
        np.radians(photos.column(name).to_numpy(zero_copy_only=False).astype(float))
        for name in ("prior_yaw_deg", "prior_pitch_deg")
    )
    geo = np.column_stack([lon, lat, height])
    known = np.flatnonzero(np.isfinite(geo).all(axis=1))
    known = (
        known[np.linspace(0, len(known) - 1, min(len(known), _MAX_PHOTOGRAPHS)).astype(int)] if len(known) else known
    )
    direction = np.column_stack([np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)])
    datum = np.array(photos.column("prior_height_datum").to_pylist(), dtype=object)
    return PhotographRays(
        geo=geo[known],
        direction=direction[known],
        sigma_m=np.nan_to_num(sigma[known], nan=5.0),
        has_datum=np.asarray(datum == HeightDatum.ELLIPSOIDAL, dtype=bool)[known],
    )


def _compute_share(vertices_site_m: Float64Nx3, triangles: Int64Nx3, rays: PhotographRays) -> float:
    """Largest share of photographs that fit the mesh, over the possible height offsets of an unknown datum."""
    surface = Surface.from_mesh(vertices_site_m, triangles)
    targets = _sample_surface(surface)
    offsets = np.zeros(1) if rays.has_datum.all() else _UNKNOWN_DATUM_M
    return max(float(_mask_fitting(surface, targets, rays, offset).mean()) for offset in offsets)


def _mask_fitting(surface: Surface, targets: Float64Nx3, rays: PhotographRays, offset_m: float) -> BoolArray:
    eyes = rays.geo + np.where(rays.has_datum, 0.0, offset_m)[:, None] * np.array([0.0, 0.0, 1.0])
    up = np.tile(np.array([0.0, 0.0, 1.0]), (len(eyes), 1))
    is_outside = ~surface.cast(eyes, up).hit
    towards = targets[None] - eyes[:, None]
    distance = np.linalg.norm(towards, axis=2)
    cosine = np.einsum("nkj,nj->nk", towards, rays.direction) / np.maximum(distance, 1e-9)
    allowance = np.radians(_LOOK_TOLERANCE_DEG) + np.arctan2(rays.sigma_m[:, None], distance)
    looks = (np.arccos(np.clip(cosine, -1.0, 1.0)) <= allowance).any(axis=1)
    fits: BoolArray = is_outside & (looks | ~np.isfinite(rays.direction).all(axis=1))
    return fits


def _sample_surface(surface: Surface) -> Float64Nx3:
    """Points (400, 3) of the surface, by area, the same ones each time."""
    random = np.random.default_rng(0)
    share = surface.areas_m2 / surface.areas_m2.sum()
    corners = surface.vertices_site_m[surface.triangles[random.choice(len(share), _SAMPLES, p=share)]]
    a, b = random.random((2, _SAMPLES, 1))
    flip = a + b > 1
    a, b = np.where(flip, 1 - a, a), np.where(flip, 1 - b, b)
    points: Float64Nx3 = corners[:, 0] + a * (corners[:, 1] - corners[:, 0]) + b * (corners[:, 2] - corners[:, 0])
    return points
