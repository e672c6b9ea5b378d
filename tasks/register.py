"""Task: bring each detection onto the building's surface, and leave out what is not of the building."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from pathlib import Path

from prefect import task

from facadelake.building.model import read_building
from facadelake.building.surface.raycasting import Surface
from facadelake.core.hashing import file_sha256
from facadelake.core.pose_table import pose_covariances, posed_cameras
from facadelake.core.tables import read_table, write_table
from facadelake.photos.files import find_masks
from facadelake.registration.exclusion import ExclusionSettings, Scene, exclude
from facadelake.registration.observe import observe
from facadelake.registration.settings import TIE_POINTS_GRAZING_DEG, RegisterSettings
from facadelake.registration.tie_points import Tracks, tie_points
from facadelake.registry import Building
from facadelake.sfm.reconstruction import Reconstruction, read_reconstruction
from schemas.vocabulary import SurfaceKind
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="register")
def register(
    job: InspectionJob,
    model: StageResult,
    placed: StageResult,
    detections: StageResult,
    block: StageResult | None,
) -> StageResult:
    """Table ``observations``, not yet merged.

    Without a ``block`` (poses were imported) there are no tie points that could show what stands before the building.
    """
    settings, exclusion = register_settings(job.building), ExclusionSettings()
    masks = find_masks(job.building.photographs_of(job.campaign_id))

    def make(folder: Path) -> Counts:
        building = read_building(model.folder)
        poses = read_table("poses", placed.folder)
        found, posed, surface = read_table("detections", detections.folder), posed_cameras(poses), Surface(building)
        table = observe(found, posed, building, surface, settings=settings, covariances=pose_covariances(poses))
        points = tie_points(_tracks(read_reconstruction(block.folder)), posed) if block else None
        passport = read_table("georeference", placed.folder).to_pylist()[0]
        scene = Scene(
            points=points,
            masks=masks,
            placement_sigma_m=max(passport[f"sigma_{axis}_m"] for axis in ("east", "north", "up")),
        )
        table = exclude(table, found, posed, building.elements, surface, scene, exclusion)
        write_table("observations", table, folder)
        return Counter(table.column("observation_outcome").to_pylist())

    inputs = {
        "masks": {photo_id: [mask.name, file_sha256(mask)] for photo_id, mask in masks.items()},
        "limits": asdict(settings),
        "exclusion": asdict(exclusion),
    }
    reads = {"model": model, "placed": placed, "detections": detections, "block": block}
    return run_stage(job, "register", reads=reads, inputs=inputs, make=make)


def _tracks(block: Reconstruction) -> Tracks:
    return Tracks(
        photo_ids=[photo.photo_id for photo in block.photos],
        photo=block.track_photo,
        point=block.track_point,
        xy_img=block.track_xy_img,
    )


def register_settings(building: Building) -> RegisterSettings:
    """The registry's tolerances, as register takes them."""
    limits = building.tolerances
    on_tie_points = building.surface_kind is SurfaceKind.AS_BUILT
    return RegisterSettings(
        grazing_above_deg=min(limits.grazing_above_deg, TIE_POINTS_GRAZING_DEG if on_tie_points else 90.0),
        target_share_min=limits.target_share_min,
        model_sigma_m=limits.model_sigma_m,
    )
