"""The building model that the registry names, read with what the registry says of it."""

from __future__ import annotations

from facadelake.building.ifc.load import load_building
from facadelake.building.mesh.files import MeshAxes
from facadelake.building.mesh.load import BareSettings, load_mesh_building
from facadelake.building.model import BuildingModel, ModelSettings
from facadelake.building.model_georeference.control_pairs import ControlPair
from facadelake.building.model_georeference.map_placement import MapPlacement
from facadelake.building.storeys import NamedFloor
from facadelake.core.geodesy import SiteOrigin
from facadelake.registry import UNITS_M, Building
from schemas.vocabulary import SurfaceKind


def read_registered_model(building: Building) -> BuildingModel:
    """The building of the registry's model file, whichever kind that is."""
    path = building.model_path()
    if building.surface_kind is SurfaceKind.MESH:
        return load_mesh_building(path, settings=bare_settings(building))
    return load_building(path, settings=model_settings(building))


def model_settings(building: Building) -> ModelSettings:
    """The registry's word on an IFC, as the reader of models takes it."""
    crs = building.crs
    return ModelSettings(
        placement=_placement(building),
        control=tuple(ControlPair(ifc_m=pair.ifc_m, map_m=pair.map_m) for pair in crs.control),
        accept_level=crs.accept_level,
        building=building.model_building or "",
        floors=_floors(building),
        map_crs=crs.map,
        vertical_datum=crs.vertical,
        origin=_origin(building),
    )


def bare_settings(building: Building) -> BareSettings:
    """The registry's word on a building without BIM, as the reader of models takes it."""
    crs = building.crs
    return BareSettings(
        map_crs=crs.map,
        vertical_datum=crs.vertical,
        placement=_placement(building),
        offset_file=building.offset_path(),
        origin=_origin(building),
        axes=MeshAxes(crs.axes) if crs.axes else None,
        unit_m=UNITS_M[crs.unit or "metre"],
        storeys=_floors(building),
    )


def _floors(building: Building) -> tuple[NamedFloor, ...]:
    return tuple(NamedFloor(name=storey.name, floor_m=storey.floor_m) for storey in building.storeys)


def _placement(building: Building) -> MapPlacement | None:
    place = building.crs.placement
    if place is None:
        return None
    return MapPlacement(
        east_m=place.east_m,
        north_m=place.north_m,
        height_m=place.height_m,
        rotation_deg=place.rotation_deg,
        scale=(place.scale, place.scale, 1.0),
    )


def _origin(building: Building) -> SiteOrigin | None:
    origin = building.crs.origin
    return SiteOrigin(**origin.model_dump()) if origin else None
