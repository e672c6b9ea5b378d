"""Comparison of two models on committed campaigns: boxes, defects, and what reviewers confirmed or rejected."""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version as version_of
from pathlib import Path

import pyarrow as pa

from facadelake.building import BuildingModel
from facadelake.campaigns import read_committed_model, read_committed_tables, register_on_committed_poses
from facadelake.core.cache import open_stage_cache
from facadelake.core.code_version import compute_code_version, require_unchanged_code
from facadelake.core.errors import FacadelakeError, InputDataError
from facadelake.core.hashing import compute_key, hash_file
from facadelake.core.tables import read_table, write_table
from facadelake.detection import SearchRegion, detect_photographs
from facadelake.detection.inference import OnnxDetector, load_detector
from facadelake.evaluation.model_comparison.box_changes import BoxChange, Change, compare_boxes
from facadelake.evaluation.model_comparison.contact_sheet import Crop, write_sheet
from facadelake.evaluation.model_comparison.defect_changes import DefectChange, compare_defects, join_detections
from facadelake.evaluation.model_comparison.report import (
    CampaignComparison,
    ComparedDetector,
    DetectorComparison,
    count_changes,
    list_lost_defects,
    locate_comparison,
    write_comparison,
)
from facadelake.evaluation.model_comparison.review_comparison import ReviewComparison, compare_with_reviews
from facadelake.photos import find_masks
from facadelake.registration import prepare_search_regions
from facadelake.registry import Building, Portfolio
from facadelake.reviews import AcceptedDetection, match_reviews, reviews_from_table, select_accepted_detections
from schemas.vocabulary import PhotoOutcome

_log = logging.getLogger("facadelake.flows")

_TABLES = ("runs", "photos", "poses", "georeference", "detections", "observations", "reviews")
_CROPS_MAX = 48  # of a sheet


@dataclass(frozen=True, kw_only=True)
class DetectorComparisonResult:
    """A comparison, its folder, and the paths of its contact sheets."""

    comparison: DetectorComparison
    folder: Path
    sheets: tuple[Path, ...]


def compare_models(
    portfolio: Portfolio,
    old: Path,
    new: Path,
    campaigns: Sequence[str],
    *,
    lake: Path,
    sample: int | None,
    folder: Path | None,
    as_of: int | None = None,
) -> DetectorComparisonResult:
    """Run two models on photographs of committed campaigns and write a report with contact sheets.

    The lake's tables are not changed; the detections of a model are kept in the lake's cache.

    Args:
        portfolio: The registered buildings.
        old: The ONNX file of the model in use.
        new: The ONNX file of the model that may replace it.
        campaigns: ``BUILDING/CAMPAIGN`` each.
        lake: Folder of the lake.
        sample: Largest number of photographs of a campaign, those with a review first; None: all.
        folder: Folder of the report; None: the default one below the lake.
        as_of: An earlier version of the lake; None: the newest.

    Raises:
        InputDataError: Both models are the same file, or a campaign is unknown.
        ModelError: A model cannot be loaded.
        StoreError: The lake does not hold a campaign, or the report cannot be written.
    """
    chosen = [_parse_campaign(portfolio, text) for text in dict.fromkeys(campaigns)]
    models = [load_detector(path, threads=1) for path in (old, new)]
    if models[0].sha256 == models[1].sha256:
        raise InputDataError(
            f"{old} and {new} are the same file; give two models (compare cards of one model with "
            "'facadelake evaluate-detector')"
        )
    report_folder = folder or locate_comparison(lake, models[0].sha256, models[1].sha256)
    results = [
        _compare_on_campaign(building, campaign_id, models, lake, sample, as_of) for building, campaign_id in chosen
    ]
    comparison = DetectorComparison(
        old=ComparedDetector(name=models[0].name, sha256=models[0].sha256),
        new=ComparedDetector(name=models[1].name, sha256=models[1].sha256),
        made_at=datetime.now(UTC).replace(microsecond=0),
        facadelake=version_of("facadelake"),
        campaigns=tuple(result.report for result in results),
    )
    write_comparison(comparison, report_folder)
    return DetectorComparisonResult(
        comparison=comparison, folder=report_folder, sheets=_draw_sheets(report_folder, results, comparison)
    )


def _parse_campaign(portfolio: Portfolio, text: str) -> tuple[Building, str]:
    building, slash, campaign_id = text.partition("/")
    if not slash or not building or not campaign_id:
        raise InputDataError(f"--campaign '{text}' is not BUILDING/CAMPAIGN, such as demo/2026-04")
    return portfolio.get_building(building), campaign_id


@dataclass(frozen=True, kw_only=True)
class _CampaignResult:
    report: CampaignComparison
    root: Path
    box_changes: tuple[BoxChange, ...]
    defect_changes: tuple[DefectChange, ...]
    reviews: ReviewComparison


def _compare_on_campaign(
    building: Building,
    campaign_id: str,
    models: Sequence[OnnxDetector],
    lake: Path,
    sample: int | None,
    as_of: int | None,
) -> _CampaignResult:
    tables = read_committed_tables(building, campaign_id, _TABLES, lake=lake, as_of=as_of)
    root = building.locate_photographs(campaign_id)
    reviews = reviews_from_table(tables["reviews"])
    chosen, total = _select_photographs(tables["photos"], {review.photo_id for review in reviews}, sample)
    photos = tables["photos"].filter(pa.compute.is_in(tables["photos"].column("photo_id"), pa.array(chosen)))
    building_model, remark = _read_committed_model(building, campaign_id, tables)
    masks = find_masks(root)
    find_region = (
        (lambda _: SearchRegion())
        if building_model is None
        else prepare_search_regions(building_model, tables["poses"], masks)
    )
    run_id = tables["runs"].column("run_id")[0].as_py()
    detections = []
    for model in models:
        parts = {
            "model": model.sha256,
            "card": model.card.model_dump(mode="json", exclude={"metrics"}),
            "classes": dict(building.detector.classes),
            "photographs": sorted(photos.column("sha256").to_pylist()),
            "run": run_id,
            "views": building_model is not None,
            "masks": {photo_id: hash_file(mask) for photo_id, mask in masks.items()},
            "code": compute_code_version(__name__).sha256,
        }
        detections.append(
            _detect_cached(lake, compute_key(parts), photos, root, model, building.detector.classes, find_region)
        )
    old, new = (select_accepted_detections(table) for table in detections)
    box_changes = compare_boxes(old, new)
    defect_changes: tuple[DefectChange, ...] = ()
    if building_model is not None and box_changes:
        joint = join_detections(box_changes, *detections)
        registered = register_on_committed_poses(building, campaign_id, building_model, joint, tables)
        defect_changes = compare_defects(registered.observations, registered.defects)
    status = match_reviews(reviews, select_accepted_detections(tables["detections"]))
    review_comparison = compare_with_reviews(status, old, new, set(chosen))
    report = CampaignComparison(
        building_id=building.id,
        campaign_id=campaign_id,
        run_id=run_id,
        photographs_total=total,
        photographs=tuple(chosen),
        boxes=count_changes(box_changes),
        wall=None if building_model is None else count_changes(defect_changes),
        wall_remark=remark,
        reviews=review_comparison.count_outcomes(),
        lost=list_lost_defects(review_comparison),
    )
    return _CampaignResult(
        report=report, root=root, box_changes=box_changes, defect_changes=defect_changes, reviews=review_comparison
    )


def _select_photographs(photos: pa.Table, reviewed: Collection[str], sample: int | None) -> tuple[list[str], int]:
    """A sample of the accepted photographs (reviewed ones first, then by the hash of the id) and the number of all."""
    accepted = [row["photo_id"] for row in photos.to_pylist() if row["photo_outcome"] == PhotoOutcome.ACCEPTED]
    order = sorted(accepted, key=lambda one: (one not in reviewed, hashlib.sha256(one.encode()).hexdigest()))
    return sorted(order[:sample]), len(accepted)


def _read_committed_model(
    building: Building, campaign_id: str, tables: Mapping[str, pa.Table]
) -> tuple[BuildingModel | None, str]:
    """The building model as committed, or the reason why it cannot be read; then only boxes are compared."""
    try:
        return read_committed_model(building, campaign_id, tables["buildings"].to_pylist()[0]), ""
    except FacadelakeError as error:
        _log.warning("%s %s: only boxes are compared, not defects: %s", building.id, campaign_id, error)
        return None, str(error)


def _detect_cached(
    lake: Path,
    key: str,
    photos: pa.Table,
    root: Path,
    model: OnnxDetector,
    classes: Mapping[str, str],
    find_region: Callable[[str], SearchRegion],
) -> pa.Table:
    """Table ``detections`` of a model, from the cache where it has processed these photographs before."""

    def make(folder: Path) -> None:
        workers = len(os.sched_getaffinity(0))
        table = detect_photographs(photos, root, model, class_names=classes, find_region=find_region, workers=workers)
        write_table("detections", table, folder)
        require_unchanged_code(__name__)

    return read_table("detections", open_stage_cache(lake).get_or_make("compare", key, make).folder)


def _draw_sheets(folder: Path, results: Sequence[_CampaignResult], comparison: DetectorComparison) -> tuple[Path, ...]:
    """Contact sheets of vanishing, appearing and lost defects, the highest scores first."""
    names = f"{comparison.old.name} {comparison.old.sha256[:8]} -> {comparison.new.name} {comparison.new.sha256[:8]}"
    sheets = []
    for change in (Change.VANISHES, Change.APPEARS):
        selected = [pair for result in results for pair in _select_boxes(result, change)]
        selected.sort(key=lambda pair: -pair[1].score)
        crops = [_crop_box(result, box) for result, box in selected[:_CROPS_MAX]]
        title = f"{change}: {len(selected)}, the {len(crops)} of the highest scores   {names}"
        sheets.append(write_sheet(folder / f"{change}.png", crops, title=title))
    lost = [(result, review) for result in results for finding in result.reviews.lost for review in finding.reviews[:1]]
    crops = [
        Crop(
            photograph=result.root / review.photo_id,
            box=review.effective_box,
            title=f"{review.defect_class} by {review.reviewer}",
            below=f"{result.report.building_id} {Path(review.photo_id).name}",
        )
        for result, review in lost[:_CROPS_MAX]
    ]
    sheets.append(write_sheet(folder / "lost.png", crops, title=f"confirmed and lost: {len(lost)}   {names}"))
    return tuple(path for path in sheets if path is not None)


def _select_boxes(result: _CampaignResult, change: Change) -> list[tuple[_CampaignResult, AcceptedDetection]]:
    """The boxes of a sheet: the best one of each changed defect, or all changed boxes where there is no building
    model."""
    boxes = [one.representative for one in result.box_changes if one.change is change]
    if result.report.wall is None:
        return [(result, box) for box in boxes]
    by_id = {box.detection_id: box for box in boxes}
    best = []
    for defect in result.defect_changes:
        of_defect = [by_id[detection_id] for detection_id in defect.detection_ids if detection_id in by_id]
        if defect.change is change and of_defect:
            best.append(max(of_defect, key=lambda box: box.score))
    return [(result, box) for box in best]


def _crop_box(result: _CampaignResult, box: AcceptedDetection) -> Crop:
    return Crop(
        photograph=result.root / box.photo_id,
        box=box.box,
        title=f"{box.defect_class} {box.score:.2f}",
        below=f"{result.report.building_id} {Path(box.photo_id).name}",
    )
