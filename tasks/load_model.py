"""Task: read the building model, mesh it once, place it on the globe."""

from __future__ import annotations

from pathlib import Path

from prefect import task

from facadelake.building.ifc.load import load_building
from facadelake.building.mesh.files import MeshAxes
from facadelake.building.mesh.load import BareSettings, load_mesh_building
from facadelake.building.model import BuildingModel, ModelSettings
from facadelake.building.model_georeference.control_pairs import ControlPair
from facadelake.building.model_georeference.selection import MapPlacement
from facadelake.building.storeys import NamedFloor
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.hashing import file_sha256
from facadelake.core.progress import stage_progress
from facadelake.registry import Building
from facadelake.registry.bare import UNITS_M, files_beside
from schemas.vocabulary import SurfaceKind
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="load model")
def load_model(job: InspectionJob) -> StageResult:
    """The building model, an IFC or a mesh, as triangles in site and a table of elements."""
    building = job.building
    path, offset = building.model_path(), building.offset_path()

    def make(folder: Path) -> Counts:
        with stage_progress(f"Reading {path.name}"):
            model = read_model(building)
        model.save(folder)
        return {"elements": len(model.elements), "triangles": len(model.triangles)}

    inputs = {
        "model": file_sha256(path),
        **{f"beside {file.name}": file_sha256(file) for file in files_beside(path)},
        "kind": building.surface_kind,
        "offset": file_sha256(offset) if offset else None,
        **building.model_dump(mode="json", include={"crs", "storeys", "model_building"}),
    }
    return run_stage(job, "load-model", reads={}, inputs=inputs, make=make)


def read_model(building: Building) -> BuildingModel:
    """The building of the registry's model file, whichever kind that is."""
    path = building.model_path()
    if building.surface_kind is SurfaceKind.MESH:
        return load_mesh_building(path, settings=bare_settings(building))
    return load_building(path, settings=model_settings(building))


def model_settings(building: Building) -> ModelSettings:
    """The registry's word on an IFC, as geobim takes it."""
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
    """The registry's word on a building without BIM, as geobim takes it."""
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
