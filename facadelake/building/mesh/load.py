"""Load a building without BIM: georeference, and a mesh segmented into facade planes as its surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from facadelake.building.mesh.facade_planes import build_plane_elements, segment_facade_planes
from facadelake.building.mesh.files import MeshAxes, MeshFile, read_mesh_file
from facadelake.building.mesh.offset import MeshOffset, read_mesh_offset
from facadelake.building.mesh.readings import MeshReading, describe_reading, list_other_readings
from facadelake.building.model import BuildingModel
from facadelake.building.model_georeference.map_placement import (
    REGISTRY_LEVEL,
    MapPlacement,
    ModelGeoreference,
    accept_operation,
    describe_map_axes,
    geo_from_map,
    require_origin_near,
)
from facadelake.building.model_georeference.selection import require_possible_heights
from facadelake.building.model_georeference.site_placement import utm_from_lon_lat
from facadelake.building.storeys import StoreyElevation, StoreyLevel
from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import Float64Nx2, Float64Nx3, Float64x3, Int64Nx3
from facadelake.core.errors import GeoreferenceError, ModelError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.proj.crs import (
    AREA_MARGIN_DEG,
    is_in_area_of_use,
    name_area_of_use,
    promote_to_3d,
)
from facadelake.core.proj.crs_parsing import parse_vertical_datum, split_crs
from facadelake.core.tables import table_from_rows
from facadelake.registry import UNITS_M
from schemas.vocabulary import SurfaceKind

_MAP_COORDINATES = MapPlacement(east_m=0.0, north_m=0.0, height_m=0.0)
_DEFAULT_UNIT = "metre"
_MAX_DEFAULT_HEIGHT_M = 200.0  # few buildings are higher, and all are in centimetres or inches
_NEARLY_SAME_UNIT = 1e-3  # the two feet
_MAX_SHIFT_M = 0.05


@dataclass(frozen=True, kw_only=True)
class MeshModelSettings:
    """What the portfolio states about a building without BIM: a mesh, or no model.

    ``map_crs``: the projected CRS; ``vertical_datum``: "ellipsoidal" or a vertical CRS such as "EPSG:7837".
    ``placement`` or ``offset_file``: position of the mesh's origin on the map; without either its coordinates are map
    coordinates. ``axes`` and ``unit`` (a key of ``UNITS_M``): how the mesh is read; None takes the format's
    default. ``origin``: origin of the site frame; None derives it from the building.
    ``accepted_operation_accuracy_m``: accuracy of a coordinate operation that is accepted where a better one lacks its
    grid.
    """

    map_crs: str | None = None
    vertical_datum: str | None = None
    placement: MapPlacement | None = None
    offset_file: Path | None = None
    origin: SiteOrigin | None = None
    axes: MeshAxes | None = None
    unit: str | None = None
    accepted_operation_accuracy_m: float | None = None
    storeys: Sequence[StoreyElevation] = ()


def load_mesh_building(path: Path, *, settings: MeshModelSettings) -> BuildingModel:
    """Load the building from the mesh at ``path``; vertices go mesh -> map -> EPSG:4979 -> site in float64.

    Raises ModelError for a mesh that cannot be used, GeoreferenceError if its position is not stated or invalid.
    """
    mesh, taken, georeference = read_placed_mesh(path, settings)
    geo = _locate_mesh(path, georeference, mesh, taken, settings)
    require_possible_heights(georeference, np.array([mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)]))
    require_origin_near(settings.origin, geo)
    building = _create_building(settings.origin or round_origin(geo), georeference, settings)
    return attach_surface(
        replace(building, surface_kind=SurfaceKind.MESH),
        building.origin.site_from_geo(georeference.geo_from_ifc(mesh.vertices_m)),
        mesh.triangles,
    )


def read_placed_mesh(path: Path, settings: MeshModelSettings) -> tuple[MeshFile, MeshReading, ModelGeoreference]:
    """The mesh, how it was read, and where it stands.

    Raises ModelError for a mesh that cannot be used, GeoreferenceError if its position is not stated.
    """
    offset = read_mesh_offset(settings.offset_file) if settings.offset_file else None
    horizontal, vertical = _resolve_crs(settings, offset)
    unit = settings.unit or _DEFAULT_UNIT
    mesh = read_mesh_file(path, axes=settings.axes, unit_m=UNITS_M[unit])
    taken = MeshReading(axes=mesh.axes, unit=unit)
    remarks = (
        _describe_placement(settings, offset, horizontal),
        describe_reading(taken, mesh.vertices_m, axes=settings.axes, unit=settings.unit),
    )
    georeference = ModelGeoreference(
        placement=settings.placement or (_placement_from_offset(offset, horizontal) if offset else _MAP_COORDINATES),
        map_crs=horizontal,
        vertical_datum=vertical,
        level=REGISTRY_LEVEL,
        remarks="; ".join(remarks),
    )
    _require_possible_height(path, taken, mesh.vertices_m, settings)
    axes = describe_map_axes(georeference)
    return mesh, taken, replace(georeference, remarks="; ".join(filter(None, (*remarks, axes))))


def _require_possible_height(
    path: Path, taken: MeshReading, vertices_m: Float64Nx3, settings: MeshModelSettings
) -> None:
    """Ask for the unit of a mesh that is very high in metres."""
    height_m = float(np.ptp(vertices_m[:, 2]))
    if settings.unit is None and height_m > _MAX_DEFAULT_HEIGHT_M:
        sizes = ", ".join(f"{height_m * UNITS_M[name]:.1f} m in {name}" for name in UNITS_M if name != taken.unit)
        raise ModelError(
            f"{path.name} is {height_m:,.0f} m high in metres (limit {_MAX_DEFAULT_HEIGHT_M:g} m where crs.unit is not "
            f"set), {sizes}; set crs.unit in the portfolio, also if it is metre"
        )


def place_building_without_model(lon_lat_deg: Float64Nx2, *, settings: MeshModelSettings) -> BuildingModel:
    """Place a building without a model at its photographs, taken at ``lon_lat_deg`` (n, 2; NaN where unknown).

    The building has no surface yet (see ``attach_surface``). The CRS is the portfolio's, else the UTM zone of WGS 84.
    Raises GeoreferenceError if neither the photographs nor the portfolio states the building's position, or the
    portfolio states no vertical datum.
    """
    known = lon_lat_deg[np.isfinite(lon_lat_deg).all(axis=1)]
    if settings.origin is None and len(known) == 0:
        raise GeoreferenceError(
            f"none of the {len(lon_lat_deg)} photographs has a GPS position and there is no model, so the building's "
            "position is unknown; set crs.origin (lon_deg, lat_deg, height_ellipsoidal_m) in the portfolio"
        )
    # The height only keeps site coordinates small. GPS heights may differ by the geoid undulation and are not used.
    origin = settings.origin or round_origin(np.append(np.median(known, axis=0), 0.0))
    with_crs = (
        settings if settings.map_crs else replace(settings, map_crs=utm_from_lon_lat(origin.lon_deg, origin.lat_deg))
    )
    horizontal, vertical = _resolve_crs(with_crs, None)
    if not is_in_area_of_use(horizontal, origin.lon_deg, origin.lat_deg, AREA_MARGIN_DEG):
        source = "crs.origin" if settings.origin else "the photographs' median GPS position"
        raise GeoreferenceError(
            f"{source}, lon {origin.lon_deg:.4f}, lat {origin.lat_deg:.4f}, lies outside the area of use of "
            f"{horizontal} ({name_area_of_use(horizontal)}); check crs.map, "
            "and whether latitude and longitude are exchanged"
        )
    georeference = ModelGeoreference(
        placement=_MAP_COORDINATES,
        map_crs=horizontal,
        vertical_datum=vertical,
        level=REGISTRY_LEVEL,
        remarks="no model: the surface is made from the campaign's tie points"
        + ("" if settings.map_crs else f"; {horizontal} is the UTM zone of the photographs' GPS positions"),
    )
    return replace(_create_building(origin, georeference, settings), surface_kind=SurfaceKind.AS_BUILT)


def attach_surface(
    building: BuildingModel,
    vertices_site_m: Float64Nx3,
    triangles: Int64Nx3,
    *,
    surface_sigma_m: float | None = None,
) -> BuildingModel:
    """Give a building a mesh as its surface, segmented into facade planes that stand for elements.

    Args:
        building: the building, whose own surface and elements are replaced.
        vertices_site_m: vertices (n, 3) in site.
        triangles: rows of the vertices (m, 3).
        surface_sigma_m: standard deviation of the surface from the real building; None: unknown.

    Returns:
        The building with the surface and one element per facade plane.

    Raises:
        ModelError: the mesh has no triangles.
    """
    surface = Surface.from_mesh(vertices_site_m, triangles)
    planes = segment_facade_planes(surface)
    return replace(
        building,
        vertices_site_m=surface.vertices_site_m,
        triangles=surface.triangles,
        element_of_triangle=planes.plane_of_triangle,
        elements=build_plane_elements(planes, surface, building.origin, building.storeys),
        surface_sigma_m=surface_sigma_m,
    )


def _resolve_crs(settings: MeshModelSettings, offset: MeshOffset | None) -> tuple[str, str]:
    """The projected CRS, of the portfolio or else of the offset file, and the vertical datum of the portfolio."""
    crs = settings.map_crs or (offset.crs if offset else None)
    if crs is None:
        raise GeoreferenceError(
            "the projected CRS of the mesh is not stated; set crs.map in the portfolio, such as EPSG:25832"
        )
    horizontal, vertical_of_crs = split_crs(crs)
    vertical = parse_vertical_datum(settings.vertical_datum) if settings.vertical_datum else vertical_of_crs
    if not vertical:
        raise GeoreferenceError(
            f"the vertical datum of the heights is not stated (CRS {horizontal}); set crs.vertical in the portfolio: "
            "'ellipsoidal', or a vertical CRS such as EPSG:7837 (DHHN2016)"
        )
    return horizontal, vertical


def _placement_from_offset(offset: MeshOffset, horizontal: str) -> MapPlacement:
    unit_m = float(promote_to_3d(horizontal).axis_info[0].unit_conversion_factor)
    if abs(unit_m - 1.0) > 1e-9:
        raise GeoreferenceError(
            f"the unit of {horizontal} is {unit_m:.6f} m, so it is unknown whether the offset file is in metres or in "
            "that unit; set crs.placement (east_m, north_m, height_m) in metres in the portfolio instead"
        )
    return MapPlacement(east_m=offset.east_m, north_m=offset.north_m, height_m=offset.height_m)


def _locate_mesh(
    path: Path,
    georeference: ModelGeoreference,
    mesh: MeshFile,
    taken: MeshReading,
    settings: MeshModelSettings,
) -> Float64x3:
    """The centre of the mesh in EPSG:4979 (3,). Raises GeoreferenceError outside the area of use of its CRS."""
    crs = georeference.map_crs
    extent = np.array([mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)])
    centre_m: Float64x3 = extent.mean(axis=0)
    centre_map = georeference.placement.map_from_ifc(centre_m[None])[0]
    if not georeference.is_in_area_of_use(centre_m):
        fitting = [
            reading
            for reading in list_other_readings(taken, axes=settings.axes, unit=settings.unit)
            if georeference.is_in_area_of_use(reading.read_vertices(centre_m[None], taken)[0], margin_deg=0.0)
        ]
        suspect = f"read with {fitting[0]}, it would lie in it; " if fitting else ""
        raise GeoreferenceError(
            f"the centre of {path.name} is at east, north, height {centre_map.round(1).tolist()} m, outside the area "
            f"of use of {crs} ({name_area_of_use(crs)}); {suspect}check crs.map in the portfolio. If a photogrammetry "
            "program exported the mesh with coordinates near zero, set crs.offset_file to the offset file that it "
            "wrote, or set crs.placement"
        )
    if settings.placement is None and settings.offset_file is None:
        _require_unit_of_crs(path, crs, centre_m, taken)
    geo: Float64x3 = georeference.geo_from_ifc(centre_m[None])[0]
    return geo


def _require_unit_of_crs(path: Path, crs: str, centre_m: Float64x3, taken: MeshReading) -> None:
    """Refuse map coordinates in one foot where the CRS has the other."""
    axis = promote_to_3d(crs).axis_info[0]
    ratio = float(axis.unit_conversion_factor) / UNITS_M[taken.unit]
    shift_m = abs(ratio - 1) * float(np.abs(centre_m[:2]).max())
    if abs(ratio - 1) < _NEARLY_SAME_UNIT and shift_m > _MAX_SHIFT_M:
        raise GeoreferenceError(
            f"{path.name} is read in {taken.unit}, the unit of {crs} is {axis.unit_name}, and the two are "
            f"{shift_m:.2f} m apart here (limit {_MAX_SHIFT_M:g} m); set crs.unit in the portfolio to that of the "
            "CRS, or set crs.placement in metres"
        )


def _describe_placement(settings: MeshModelSettings, offset: MeshOffset | None, horizontal: str) -> str:
    if settings.placement is not None:
        return "the mesh is placed by crs.placement of the portfolio"
    if offset is None:
        return "the mesh's coordinates are taken as map coordinates"
    conflict = f"; it names {offset.crs}, the portfolio {horizontal}" if offset.crs not in (None, horizontal) else ""
    return (
        f"the mesh's origin is at east {offset.east_m:.3f}, north {offset.north_m:.3f}, height {offset.height_m:.3f} m "
        f"by its offset file{conflict}"
    )


def _create_building(origin: SiteOrigin, georeference: ModelGeoreference, settings: MeshModelSettings) -> BuildingModel:
    """The building without a surface."""
    georeference = accept_operation(georeference, origin, settings.accepted_operation_accuracy_m)
    building = BuildingModel(
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
    return replace(building, storeys=_compute_storey_levels(building, settings.storeys))


def _compute_storey_levels(building: BuildingModel, storeys: Sequence[StoreyElevation]) -> tuple[StoreyLevel, ...]:
    """Levels of the storeys' floors in site at the site's origin, sorted by level."""
    east, north, _ = building.map_from_site(np.zeros((1, 3)))[0]
    levels = []
    for storey in sorted(storeys, key=lambda storey: storey.floor_m):
        floor = geo_from_map(np.array([[east, north, storey.floor_m]]), building.map_crs, building.vertical_datum)
        level = float(building.origin.site_from_geo(floor)[0, 2])
        levels.append(StoreyLevel(name=storey.name, floor_site_m=level))
    return tuple(levels)


def round_origin(geo: Float64x3) -> SiteOrigin:
    """Origin at ``geo`` (lon_deg, lat_deg, height_ellipsoidal_m), rounded so that small corrections do not move it."""
    lon, lat, height = (float(value) for value in geo)
    return SiteOrigin(lon_deg=round(lon, 3), lat_deg=round(lat, 3), height_ellipsoidal_m=round(height, -1))
