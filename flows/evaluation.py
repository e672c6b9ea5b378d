"""Compare a committed campaign with truth; the lake is read, never changed."""

from __future__ import annotations

from pathlib import Path

from facadelake.detect.coco import import_coco
from facadelake.errors import InputDataError, StoreError
from facadelake.evaluate.evaluation import evaluate
from facadelake.evaluate.figures import Figures
from facadelake.geobim.surface import Surface
from facadelake.geodesy import SiteOrigin
from facadelake.lake.connect import exists
from facadelake.lake.read import read_table
from facadelake.posed import posed_cameras
from facadelake.register.merge import merge
from facadelake.register.observe import observe
from facadelake.register.settings import MergeSettings
from facadelake.registry import Building, CocoDetector
from schemas.vocabulary import ControlKind, SurfaceKind
from tasks.load_model import read_model
from tasks.register import register_settings


def evaluate_campaign(
    building: Building, campaign_id: str, *, lake: Path, truth: Path, detections: str | None
) -> Figures:
    """The figures of methods.md for a committed campaign.

    With ``detections`` another file is registered and merged on the committed poses, in memory.
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
        settings = MergeSettings.under(ControlKind(tables["georeference"].column("control")[0].as_py()))
        posed = posed_cameras(tables["poses"])
        seen = observe(found, posed, model, Surface(model), settings=register_settings(building))
        merged = merge(seen, found, model, posed, prefix=f"{building.id}-{campaign_id}", settings=settings)
        tables |= {"detections": found, "observations": merged.observations, "defects": merged.defects}
    return evaluate(
        photos=tables["photos"],
        poses=tables["poses"],
        detections=tables["detections"],
        observations=tables["observations"],
        defects=tables["defects"],
        truth=truth,
        origin=origin,
        map_crs=place["map_crs"],
    )
