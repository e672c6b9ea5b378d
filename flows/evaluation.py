"""Compare a committed campaign with truth; the lake is read, never changed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa

from facadelake.building.model import BuildingModel
from facadelake.building.surface.raycasting import Surface
from facadelake.core.errors import InputDataError, StoreError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.pose_table import pose_covariances, posed_cameras
from facadelake.deduplication.appearance import Photographs
from facadelake.deduplication.merge import MergeResult, merge
from facadelake.detection.coco.import_detections import import_coco
from facadelake.evaluation.campaigns.comparison import Comparison, compare
from facadelake.lake.connect import exists
from facadelake.lake.read import read_table
from facadelake.photos.files import find_masks
from facadelake.registration.exclusion import ExclusionSettings, Scene, exclude
from facadelake.registration.observe import observe
from facadelake.registry import Building, CocoDetector
from schemas.vocabulary import SurfaceKind
from tasks.load_model import read_model
from tasks.merge import merge_settings
from tasks.register import register_settings


def compare_campaign(
    building: Building, campaign_id: str, *, lake: Path, truth: Path, detections: str | None
) -> Comparison:
    """A committed campaign beside truth; ``figures_of`` and ``write_plots`` tell of it.

    With ``detections`` another file is registered and merged on the committed poses, in memory; tie points, which tell
    what stands before the building, are not in the lake, so that only masks and geometry exclude there.
    Raises StoreError where the lake does not hold the campaign, InputDataError where the truth is not usable.
    """
    names = ("buildings", "photos", "poses", "georeference", "detections", "observations", "defects")
    if not exists(lake):
        raise StoreError(f"there is no lake at {lake}; run 'facadelake inspect {building.id} {campaign_id}' first")
    tables = {name: read_table(lake, name, building_id=building.id, campaign_id=campaign_id) for name in names}
    if not len(tables["buildings"]):
        raise StoreError(
            f"the lake {lake} does not hold {building.id} {campaign_id}; "
            f"run 'facadelake inspect {building.id} {campaign_id}' first, or see 'facadelake campaigns'"
        )
    place = tables["buildings"].to_pylist()[0]
    origin = SiteOrigin(
        lon_deg=place["origin_lon_deg"],
        lat_deg=place["origin_lat_deg"],
        height_ellipsoidal_m=place["origin_height_ellipsoidal_m"],
    )
    if detections is not None:
        if not isinstance(building.detector, CocoDetector):
            raise InputDataError(
                f"--detections needs a building whose detector reads COCO files; '{building.id}' has an ONNX model"
            )
        file = building.detections_of(campaign_id, detections)
        if building.surface_kind is SurfaceKind.AS_BUILT:
            raise InputDataError(
                f"building '{building.id}' has no model (model: as-built), so other detections cannot be registered "
                f"here; run 'facadelake inspect {building.id} {campaign_id} --detections ...' and evaluate that"
            )
        model = read_model(building)
        found = import_coco(file, tables["photos"], class_names=building.detector.classes)
        merged = registered_again(building, campaign_id, model, found, tables)
        tables |= {"detections": found, "observations": merged.observations, "defects": merged.defects}
    return compare(
        photos=tables["photos"],
        poses=tables["poses"],
        detections=tables["detections"],
        observations=tables["observations"],
        defects=tables["defects"],
        truth=truth,
        origin=origin,
        map_crs=place["map_crs"],
    )


def registered_again(
    building: Building, campaign_id: str, model: BuildingModel, found: pa.Table, tables: Mapping[str, pa.Table]
) -> MergeResult:
    """Other detections of a committed campaign, ``found``, registered and merged on its poses, in memory.

    ``tables``: the campaign's ``poses`` and ``georeference``. What stands before the building is told by the user's
    masks and the model alone, because tie points are not in the lake.
    """
    passport = tables["georeference"].to_pylist()[0]
    posed, surface = posed_cameras(tables["poses"]), Surface(model)
    covariances = pose_covariances(tables["poses"])
    root = building.photographs_of(campaign_id)
    seen = observe(found, posed, model, surface, settings=register_settings(building), covariances=covariances)
    scene = Scene(
        masks=find_masks(root),
        placement_sigma_m=max(passport[f"sigma_{axis}_m"] for axis in ("east", "north", "up")),
    )
    seen = exclude(seen, found, posed, model.elements, surface, scene, ExclusionSettings())
    return merge(
        seen,
        found,
        model,
        posed,
        prefix=f"{building.id}-{campaign_id}",
        settings=merge_settings(passport),
        covariances=covariances,
        photographs=Photographs(root=root, posed=posed),
    )
