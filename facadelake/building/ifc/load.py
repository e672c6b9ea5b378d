"""Load a building model from an IFC file: geometry, georeference and elements."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import ifcopenshell
import numpy as np

from facadelake.building.ifc.elements import build_elements_table
from facadelake.building.ifc.identity import describe_shared_guids
from facadelake.building.ifc.meshes import describe_missing, drop_distant_elements, mesh_elements, open_ifc
from facadelake.building.ifc.sizes import check_sizes
from facadelake.building.ifc.structure import IfcStorey, get_building, label_buildings, read_storeys
from facadelake.building.model import BuildingModel
from facadelake.building.model_georeference.candidates import find_georeferences
from facadelake.building.model_georeference.control_pairs import ControlPair
from facadelake.building.model_georeference.length_units import LengthUnit, read_project_unit
from facadelake.building.model_georeference.map_placement import MapPlacement, ModelGeoreference, require_origin_near
from facadelake.building.model_georeference.selection import select_georeference
from facadelake.building.storeys import StoreyElevation, StoreyLevel
from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import Float64x3, Float64x3x3
from facadelake.core.errors import ModelError
from facadelake.core.geodesy import SiteOrigin

_log = logging.getLogger(__name__)
# What ifcopenshell and numpy raise on entities that lack attributes or have values of another kind.
_DAMAGED = (AttributeError, TypeError, ValueError, KeyError, IndexError, RuntimeError, OverflowError)
_FALSE_ORIGIN_M = 10_000.0  # a model origin farther from the building than this is a false origin


@dataclass(frozen=True, kw_only=True)
class IfcModelSettings:
    """What the portfolio states about an IFC model; None means that the IFC's own statement applies.

    ``vertical_datum`` is "ellipsoidal" or a vertical CRS such as "EPSG:7837". ``control`` (pairs of points of the model
    and of the map), else ``placement``, replaces the IFC's georeference. ``accept_level`` is the lowest LoGeoRef level
    that is accepted although its accuracy is metres. ``map_unit`` replaces MapUnit. ``building`` selects one
    IfcBuilding by name or GlobalId; empty takes all. ``storeys`` apply where the IFC has none. ``origin`` is the origin
    of the site frame. ``mesh_deflection_m`` is the largest distance of a triangle from the curved surface it
    approximates. ``workers`` is the number of threads that mesh elements.
    """

    map_crs: str | None = None
    vertical_datum: str | None = None
    placement: MapPlacement | None = None
    control: tuple[ControlPair, ...] = ()
    accept_level: int | None = None
    map_unit: LengthUnit | None = None
    accepted_operation_accuracy_m: float | None = None
    building: str = ""
    storeys: tuple[StoreyElevation, ...] = ()
    origin: SiteOrigin | None = None
    mesh_deflection_m: float = 0.001
    workers: int = 2


def load_ifc_building(path: Path, *, settings: IfcModelSettings) -> BuildingModel:
    """Load the building from the IFC at ``path``; vertices go ifc -> map -> EPSG:4979 -> site in float64.

    Raises ModelError for a file that is missing, truncated, without surfaces or of impossible size, GeoreferenceError
    if neither the IFC nor ``settings`` states the position, the CRS or the vertical datum.
    """
    model = open_ifc(path)
    try:
        return _load_building(model, settings)
    except _DAMAGED as error:
        raise ModelError(
            f"building model {path} has an entity with missing or wrong attributes ({type(error).__name__}: {error}); "
            "check it with an IFC validator, and export it again"
        ) from error


def _load_building(model: ifcopenshell.file, settings: IfcModelSettings) -> BuildingModel:
    unit = read_project_unit(model)
    labels = label_buildings(model)
    selected = get_building(model, settings.building, labels) if settings.building else None
    candidates = find_georeferences(
        model,
        map_crs=settings.map_crs,
        vertical_datum=settings.vertical_datum,
        placement=settings.placement,
        control=settings.control,
        accept_level=settings.accept_level,
        map_unit=settings.map_unit,
        accepted_operation_accuracy_m=settings.accepted_operation_accuracy_m,
    )
    storeys_of_ifc = read_storeys(model, labels, selected)
    meshes = mesh_elements(model, deflection_m=settings.mesh_deflection_m, workers=settings.workers, building=selected)
    missing = describe_missing(model, meshes, selected)
    meshes, dropped = drop_distant_elements(meshes)
    sizes = check_sizes(model, meshes, [storey.level_m for storey in storeys_of_ifc])
    vertices_ifc = np.vstack([mesh.vertices_ifc_m for mesh in meshes])
    extent = np.array([vertices_ifc.min(axis=0), vertices_ifc.max(axis=0)])
    centre = extent.mean(axis=0)
    georeference = select_georeference(candidates, extent)
    require_origin_near(settings.origin, georeference.geo_from_ifc(centre[None])[0])
    origin = settings.origin or choose_site_origin(georeference, centre)
    starts = np.cumsum([0, *(len(mesh.vertices_ifc_m) for mesh in meshes[:-1])])
    triangles = np.vstack([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)])
    element_of_triangle = np.repeat(np.arange(len(meshes)), [len(mesh.triangles) for mesh in meshes])
    vertices = origin.site_from_geo(georeference.geo_from_ifc(vertices_ifc))
    surface = Surface.from_mesh(vertices, triangles, element_of_triangle)
    _log.info("%d elements, %d triangles, %s, heights %s", len(meshes), len(triangles), georeference.map_crs,
              georeference.vertical_datum)  # fmt: skip
    storeys = storeys_of_ifc or _convert_registry_storeys(settings.storeys, georeference)
    elements = build_elements_table(
        model,
        meshes,
        surface,
        site_from_ifc=_compute_site_from_ifc(georeference, origin, centre),
        origin=origin,
        storeys=storeys,
    )
    remarks = [
        georeference.remarks,
        unit.remark,
        describe_shared_guids({mesh.step_id: mesh.guid for mesh in meshes}),
        missing,
        dropped,
        sizes,
        _describe_buildings(model, labels, selected),
    ]
    return BuildingModel(
        origin=origin,
        map_crs=georeference.map_crs,
        vertical_datum=georeference.vertical_datum,
        georeference_level=georeference.level,
        remarks="; ".join(filter(None, remarks)),
        vertices_site_m=vertices,
        triangles=triangles,
        element_of_triangle=element_of_triangle,
        elements=elements,
        storeys=_compute_storey_levels(storeys, georeference, origin, centre),
    )


def choose_site_origin(georeference: ModelGeoreference, centre_ifc_m: Float64x3) -> SiteOrigin:
    """The model's origin, rounded to 1e-4 degrees and 10 m so that small corrections do not move it.

    If the model's origin is far from the building (a false origin), the centre of the building is used instead.
    """
    anchor_ifc_m = centre_ifc_m if np.linalg.norm(centre_ifc_m) > _FALSE_ORIGIN_M else np.zeros(3)
    lon, lat, height = georeference.geo_from_ifc(anchor_ifc_m[None])[0]
    return SiteOrigin(
        lon_deg=round(float(lon), 4), lat_deg=round(float(lat), 4), height_ellipsoidal_m=round(float(height), -1)
    )


def _compute_site_from_ifc(georeference: ModelGeoreference, origin: SiteOrigin, centre_ifc_m: Float64x3) -> Float64x3x3:
    """Rotation (3, 3) from the model's axes to site at the centre of the building."""
    points = centre_ifc_m + np.vstack([np.zeros(3), np.eye(3)])
    xyz = origin.site_from_geo(georeference.geo_from_ifc(points))
    u, _, vt = np.linalg.svd((xyz[1:] - xyz[0]).T)
    rotation: Float64x3x3 = u @ vt
    return rotation


def _convert_registry_storeys(storeys: Sequence[StoreyElevation], georeference: ModelGeoreference) -> list[IfcStorey]:
    """The portfolio's storeys in the model's axes, sorted by level; the model is upright."""
    placement = georeference.placement
    converted = [
        IfcStorey(name=storey.name, level_m=(storey.floor_m - placement.height_m) / placement.scale[2])
        for storey in storeys
    ]
    return sorted(converted, key=lambda storey: storey.level_m)


def _compute_storey_levels(
    storeys: Sequence[IfcStorey], georeference: ModelGeoreference, origin: SiteOrigin, centre_ifc_m: Float64x3
) -> tuple[StoreyLevel, ...]:
    """Levels of the storeys' floors in site, at the centre of the building."""
    if not storeys:
        return ()
    floors = np.array([[centre_ifc_m[0], centre_ifc_m[1], storey.level_m] for storey in storeys])
    levels = origin.site_from_geo(georeference.geo_from_ifc(floors))[:, 2]
    return tuple(
        StoreyLevel(name=storey.name, floor_site_m=float(level), building=storey.building)
        for storey, level in zip(storeys, levels, strict=True)
    )


def _describe_buildings(
    model: ifcopenshell.file, labels: Mapping[int, str], selected: ifcopenshell.entity_instance | None
) -> str:
    """Remark on which of several buildings were loaded; empty if the file has one."""
    buildings = model.by_type("IfcBuilding")
    if len(buildings) < 2:
        return ""
    if selected is not None:
        return f"of the IFC's {len(buildings)} buildings only '{labels[selected.id()]}' was loaded"
    names = {building.Name or building.LongName for building in buildings}
    # A label that is not the name in the IFC is explained by the GlobalId.
    listed = [
        f"'{labels[one.id()]}'" + ("" if labels[one.id()] in names else f" ({one.GlobalId})") for one in buildings[:5]
    ]
    return (
        f"the IFC has {len(buildings)} buildings ({', '.join(listed)}), all loaded; set model_building in the "
        "portfolio to load one"
    )
