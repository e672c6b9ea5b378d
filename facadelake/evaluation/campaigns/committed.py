"""Compare a committed campaign with truth; the lake is read, never changed."""

from __future__ import annotations

from pathlib import Path

from facadelake.building import read_registered_model
from facadelake.campaigns import committed_tables, register_on_committed_poses
from facadelake.core.errors import InputDataError
from facadelake.core.geodesy import SiteOrigin
from facadelake.detection.coco import import_coco
from facadelake.evaluation.campaigns.comparison import TruthComparison, compare_with_truth
from facadelake.registry import Building, CocoDetectorSetting
from schemas.vocabulary import SurfaceKind


def compare_campaign(
    building: Building, campaign_id: str, *, lake: Path, truth: Path, detections: str | None
) -> TruthComparison:
    """A committed campaign beside truth; ``figures_of`` and ``write_plots`` tell of it.

    With ``detections`` another file is registered and merged on the committed poses, in memory; tie points, which tell
    what stands before the building, are not in the lake, so that only masks and geometry exclude there.
    Raises StoreError where the lake does not hold the campaign, InputDataError where the truth is not usable.
    """
    names = ("photos", "poses", "georeference", "detections", "observations", "defects")
    tables = committed_tables(building, campaign_id, names, lake=lake)
    place = tables["buildings"].to_pylist()[0]
    origin = SiteOrigin(
        lon_deg=place["origin_lon_deg"],
        lat_deg=place["origin_lat_deg"],
        height_ellipsoidal_m=place["origin_height_ellipsoidal_m"],
    )
    if detections is not None:
        if not isinstance(building.detector, CocoDetectorSetting):
            raise InputDataError(
                f"--detections needs a building whose detector reads COCO files; '{building.id}' has an ONNX model"
            )
        file = building.locate_detections(campaign_id, detections)
        if building.surface_kind is SurfaceKind.AS_BUILT:
            raise InputDataError(
                f"building '{building.id}' has no model (model: as-built), so other detections cannot be registered "
                f"here; run 'facadelake inspect {building.id} {campaign_id} --detections ...' and evaluate that"
            )
        model = read_registered_model(building)
        found = import_coco(file, tables["photos"], class_names=building.detector.classes)
        merged = register_on_committed_poses(building, campaign_id, model, found, tables)
        tables |= {"detections": found, "observations": merged.observations, "defects": merged.defects}
    return compare_with_truth(
        photos=tables["photos"],
        poses=tables["poses"],
        detections=tables["detections"],
        observations=tables["observations"],
        defects=tables["defects"],
        truth=truth,
        origin=origin,
        map_crs=place["map_crs"],
    )
