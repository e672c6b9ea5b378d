"""A building without BIM: its place on the globe, and a mesh cut into facade planes as its surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyproj

from facadelake.building.mesh.facade_planes import build_plane_elements, segment_facade_planes
from facadelake.building.mesh.files import MeshAxes, read_mesh_file
from facadelake.building.mesh.offset import MeshOffset, read_mesh_offset
from facadelake.building.model import BuildingModel
from facadelake.building.model_georeference.crs import parse_vertical_datum, split_crs
from facadelake.building.model_georeference.map_placement import MapPlacement, ModelGeoreference, geo_from_map
from facadelake.building.model_georeference.site_placement import utm_from_lon_lat
from facadelake.building.storeys import StoreyElevation, StoreyLevel
from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import SiteOrigin, promote_to_3d
from facadelake.core.tables import table_from_rows
from schemas.vocabulary import SurfaceKind

_REGISTRY = "registry"
_AREA_MARGIN_DEG = 1.0  # how far outside a CRS's area of use a building may stand
_MAP_COORDINATES = MapPlacement(east_m=0.0, north_m=0.0, height_m=0.0)


@dataclass(frozen=True, kw_only=True)
class MeshModelSettings:
    """What the registry says about a building that has no BIM.

    ``map_crs``: the projected CRS; ``vertical_datum``: "ellipsoidal" or a vertical CRS such as "EPSG:7837".
    ``placement`` or ``offset_file``: where a mesh's zero lies on the map; without either its coordinates are the
    map's. ``unit_m``: metres of the mesh's unit. ``origin``: of the site frame, else it is taken from the building.
    """

    map_crs: str | None = None
    vertical_datum: str | None = None
    placement: MapPlacement | None = None
    offset_file: Path | None = None
    origin: SiteOrigin | None = None
    axes: MeshAxes | None = None
    unit_m: float = 1.0
    storeys: Sequence[StoreyElevation] = ()


def load_mesh_building(path: Path, *, settings: MeshModelSettings) -> BuildingModel:
    """The building whose surface is the mesh at ``path``, every vertex mesh -> map -> EPSG:4979 -> site in float64.

    Raises ModelError for a mesh that cannot be used, GeoreferenceError where its place is not said or impossible.
    """
    offset = read_mesh_offset(settings.offset_file) if settings.offset_file else None
    horizontal, vertical = _resolve_crs(settings, offset)
    mesh = read_mesh_file(path, axes=settings.axes, unit_m=settings.unit_m)
    georeference = ModelGeoreference(
        placement=settings.placement or (_placement_from_offset(offset, horizontal) if offset else _MAP_COORDINATES),
        map_crs=horizontal,
        vertical_datum=vertical,
        level=_REGISTRY,
        remarks=_describe_placement(settings, offset, horizontal),
    )
    middle = (mesh.vertices_m.min(axis=0) + mesh.vertices_m.max(axis=0)) / 2
    geo = _locate_mesh(path, georeference, middle)
    place = _create_building(settings.origin or _round_origin(geo), georeference, settings)
    return attach_surface(
        replace(place, surface_kind=SurfaceKind.MESH),
        place.origin.site_from_geo(georeference.geo_from_ifc(mesh.vertices_m)),
        mesh.triangles,
    )


def place_building_without_model(lon_lat_deg: Float64Array, *, settings: MeshModelSettings) -> BuildingModel:
    """The place of a building of which nothing is known but its photographs, taken at ``lon_lat_deg`` (n, 2; NaN where
    a photograph does not say); its surface is still to be made (``attach_surface``).

    The CRS is the registry's, else the UTM zone of WGS 84. Raises GeoreferenceError where neither the photographs nor
    the registry says where the building stands, or the registry does not say what heights refer to.
    """
    known = lon_lat_deg[np.isfinite(lon_lat_deg).all(axis=1)]
    if settings.origin is None and len(known) == 0:
        raise GeoreferenceError(
            f"none of the {len(lon_lat_deg)} photographs says where it was taken and there is no model, so the "
            "building has no place; give the registry's crs.origin (lon_deg, lat_deg, height_ellipsoidal_m)"
        )
    # The height only keeps site coordinates small; GPS heights may be off by the geoid, so none is taken from them.
    origin = settings.origin or _round_origin(np.append(np.median(known, axis=0), 0.0))
    own = settings if settings.map_crs else replace(settings, map_crs=utm_from_lon_lat(origin.lon_deg, origin.lat_deg))
    horizontal, vertical = _resolve_crs(own, None)
    georeference = ModelGeoreference(
        placement=_MAP_COORDINATES,
        map_crs=horizontal,
        vertical_datum=vertical,
        level=_REGISTRY,
        remarks="no model: the surface is the campaign's own tie points"
        + ("" if settings.map_crs else f"; {horizontal} is the UTM zone of the photographs' GPS"),
    )
    return replace(_create_building(origin, georeference, settings), surface_kind=SurfaceKind.AS_BUILT)


def attach_surface(
    place: BuildingModel,
    vertices_site_m: Float64Array,
    triangles: Int64Array,
    *,
    surface_sigma_m: float | None = None,
) -> BuildingModel:
    """``place`` with a mesh (n, 3), (m, 3) in site as its surface, cut into facade planes that stand for elements."""
    surface = Surface.from_mesh(vertices_site_m, triangles)
    planes = segment_facade_planes(surface)
    return replace(
        place,
        vertices_site_m=surface.vertices_site_m,
        triangles=surface.triangles,
        element_of_triangle=planes.plane_of_triangle,
        elements=build_plane_elements(planes, surface, place.origin, place.storeys),
        surface_sigma_m=surface_sigma_m,
    )


def _resolve_crs(settings: MeshModelSettings, offset: MeshOffset | None) -> tuple[str, str]:
    """The projected CRS and the vertical datum, each from the registry, the CRS also from the offset file."""
    named = settings.map_crs or (offset.crs if offset else None)
    if named is None:
        raise GeoreferenceError(
            "nothing says which projected CRS the mesh stands in; give the registry's crs.map, such as EPSG:25832"
        )
    horizontal, by_crs = split_crs(named)
    vertical = parse_vertical_datum(settings.vertical_datum) if settings.vertical_datum else by_crs
    if not vertical:
        raise GeoreferenceError(
            f"nothing says what heights refer to (CRS {horizontal}); give the registry's crs.vertical: 'ellipsoidal', "
            "or a vertical CRS such as EPSG:5783 (DHHN92)"
        )
    return horizontal, vertical


def _placement_from_offset(offset: MeshOffset, horizontal: str) -> MapPlacement:
    unit_m = float(promote_to_3d(horizontal).axis_info[0].unit_conversion_factor)
    if abs(unit_m - 1.0) > 1e-9:
        raise GeoreferenceError(
            f"an offset file beside {horizontal}, which counts in {unit_m:.6f} m: whether the offset is in metres or "
            "in the CRS's unit is not said; give crs.placement (east_m, north_m, height_m) in metres instead"
        )
    return MapPlacement(east_m=offset.east_m, north_m=offset.north_m, height_m=offset.height_m)


def _locate_mesh(path: Path, georeference: ModelGeoreference, middle_m: Float64Array) -> Float64Array:
    """The mesh's middle in EPSG:4979 (3,). Raises GeoreferenceError where its CRS is not in use there."""
    crs = georeference.map_crs
    area = pyproj.CRS.from_user_input(crs).area_of_use
    found = georeference.placement.map_from_ifc(middle_m[None])[0]
    try:
        geo: Float64Array = georeference.geo_from_ifc(middle_m[None])[0]
        inside = area is None or (
            (geo[0] - area.west + _AREA_MARGIN_DEG) % 360 <= (area.east - area.west) % 360 + 2 * _AREA_MARGIN_DEG
            and area.south - _AREA_MARGIN_DEG <= geo[1] <= area.north + _AREA_MARGIN_DEG
        )
    except GeoreferenceError as error:
        if "domain" not in str(error):
            raise
        inside = False
    if not inside:
        raise GeoreferenceError(
            f"the middle of {path.name} comes to lie at east, north, height {found.round(1).tolist()} m, outside the "
            f"area where {crs} is in use ({area.name.split(':')[0] if area else 'unknown'}); is the CRS the right one? "
            "A mesh that photogrammetry exported stands near its own zero: give the offset file it came with "
            "(crs.offset_file), or crs.placement"
        )
    return geo


def _describe_placement(settings: MeshModelSettings, offset: MeshOffset | None, horizontal: str) -> str:
    if settings.placement is not None:
        return "the mesh's place is the registry's crs.placement"
    if offset is None:
        return "the mesh's coordinates are taken as the map's"
    said = f"the mesh's zero lies at east {offset.east_m:.3f}, north {offset.north_m:.3f}, height {offset.height_m:.3f}"
    other = f"; it names {offset.crs}, the registry {horizontal}" if offset.crs not in (None, horizontal) else ""
    return f"{said} m by its offset file{other}"


def _create_building(origin: SiteOrigin, georeference: ModelGeoreference, settings: MeshModelSettings) -> BuildingModel:
    bare = BuildingModel(
        origin=origin,
        map_crs=georeference.map_crs,
        vertical_datum=georeference.vertical_datum,
        georeference_level=georeference.level,
        remarks=georeference.remarks,
        vertices_site_m=np.zeros((0, 3)),
        triangles=np.zeros((0, 3), dtype=np.int64),
        element_of_triangle=np.zeros(0, dtype=np.int64),
        elements=table_from_rows("elements", []),
    )
    return replace(bare, storeys=_compute_storey_levels(bare, settings.storeys))


def _compute_storey_levels(place: BuildingModel, storeys: Sequence[StoreyElevation]) -> tuple[StoreyLevel, ...]:
    """The storeys' floors in site at the site's origin, from the lowest up."""
    east, north, _ = place.map_from_site(np.zeros((1, 3)))[0]
    levels = []
    for storey in sorted(storeys, key=lambda storey: storey.floor_m):
        floor = geo_from_map(np.array([[east, north, storey.floor_m]]), place.map_crs, place.vertical_datum)
        level = float(place.origin.site_from_geo(floor)[0, 2])
        levels.append(StoreyLevel(name=storey.name, floor_site_m=level))
    return tuple(levels)


def _round_origin(geo: Float64Array) -> SiteOrigin:
    """An origin near ``geo`` (lon_deg, lat_deg, height_ellipsoidal_m) that small changes of it do not move."""
    lon, lat, height = (float(value) for value in geo)
    return SiteOrigin(lon_deg=round(lon, 3), lat_deg=round(lat, 3), height_ellipsoidal_m=round(height, -1))
