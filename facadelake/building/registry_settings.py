"""Read the building model that the portfolio names, with settings converted from the portfolio's records."""

from __future__ import annotations

import pyarrow as pa

from facadelake.building.ifc.load import IfcModelSettings
from facadelake.building.ifc.worker_process import read_ifc_building
from facadelake.building.mesh.files import MeshAxes
from facadelake.building.mesh.load import MeshModelSettings, load_mesh_building
from facadelake.building.mesh.other_readings import (
    SurfaceReading,
    check_mesh_against_photographs,
    list_surface_readings,
)
from facadelake.building.model import BuildingModel
from facadelake.building.model_georeference.control_pairs import ControlPair
from facadelake.building.model_georeference.length_units import LengthUnit
from facadelake.building.model_georeference.map_placement import MapPlacement
from facadelake.building.storeys import StoreyElevation
from facadelake.core.geodesy import SiteOrigin
from facadelake.registry import UNITS_M, Building
from schemas.vocabulary import SurfaceKind


def read_registered_model(building: Building) -> BuildingModel:
    """Read the building's model file, an IFC or a mesh."""
    path = building.locate_model()
    if building.surface_kind is SurfaceKind.MESH:
        return load_mesh_building(path, settings=mesh_settings_from_registry(building))
    return read_ifc_building(path, settings=ifc_settings_from_registry(building))


def check_registered_mesh(building: Building, photos: pa.Table) -> None:
    """Check the reading of the building's mesh against table ``photos``; no mesh, nothing to check.

    Raises GeoreferenceError if the photographs fit another upward axis or unit.
    """
    if building.surface_kind is SurfaceKind.MESH:
        check_mesh_against_photographs(building.locate_model(), photos, settings=mesh_settings_from_registry(building))


def list_registered_readings(building: Building, origin: SiteOrigin) -> tuple[SurfaceReading, ...]:
    """The surfaces of the building's mesh by all readings that the portfolio leaves open, the one taken first.

    ``origin`` is that of the site frame. Empty for another kind of model, and where the portfolio states axis and unit.
    """
    if building.surface_kind is not SurfaceKind.MESH:
        return ()
    return list_surface_readings(building.locate_model(), origin, settings=mesh_settings_from_registry(building))


def ifc_settings_from_registry(building: Building) -> IfcModelSettings:
    """Convert the portfolio's statements about an IFC model to settings of its loader."""
    crs = building.crs
    return IfcModelSettings(
        placement=_placement_from_registry(building),
        control=tuple(ControlPair(ifc_m=pair.ifc_m, map_m=pair.map_m) for pair in crs.control),
        accept_level=crs.accept_level,
        accepted_operation_accuracy_m=crs.accept_operation_accuracy_m,
        building=building.model_building or "",
        storeys=_storeys_from_registry(building),
        map_crs=crs.map,
        vertical_datum=crs.vertical,
        map_unit=LengthUnit(name=crs.map_unit, metres=UNITS_M[crs.map_unit]) if crs.map_unit else None,
        origin=_origin_from_registry(building),
    )


def mesh_settings_from_registry(building: Building) -> MeshModelSettings:
    """Convert the portfolio's statements about a mesh, or a building without a model, to settings of its loader."""
    crs = building.crs
    return MeshModelSettings(
        map_crs=crs.map,
        vertical_datum=crs.vertical,
        placement=_placement_from_registry(building),
        offset_file=building.locate_offset_file(),
        origin=_origin_from_registry(building),
        accepted_operation_accuracy_m=crs.accept_operation_accuracy_m,
        axes=MeshAxes(crs.axes) if crs.axes else None,
        unit=crs.unit,
        storeys=_storeys_from_registry(building),
    )


def _storeys_from_registry(building: Building) -> tuple[StoreyElevation, ...]:
    return tuple(StoreyElevation(name=storey.name, floor_m=storey.floor_m) for storey in building.storeys)


def _placement_from_registry(building: Building) -> MapPlacement | None:
    placement = building.crs.placement
    if placement is None:
        return None
    return MapPlacement(
        east_m=placement.east_m,
        north_m=placement.north_m,
        height_m=placement.height_m,
        rotation_deg=placement.rotation_deg,
        scale=(placement.scale, placement.scale, 1.0),
    )


def _origin_from_registry(building: Building) -> SiteOrigin | None:
    origin = building.crs.origin
    return SiteOrigin(**origin.model_dump()) if origin else None
