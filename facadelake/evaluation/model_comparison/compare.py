"""Two models on stored campaigns: what appears, what vanishes, what persons said of it."""

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
from facadelake.core.code_version import compute_code_version
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
    ComparedModel,
    ModelComparison,
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
_CROPS_MAX = 48  # a sheet


@dataclass(frozen=True, kw_only=True)
class ModelComparisonResult:
    """A comparison, its folder, and the sheets drawn there."""

    comparison: ModelComparison
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
) -> ModelComparisonResult:
    """Run both models on the photographs of ``campaigns`` (building/campaign) and write what differs.

    ``sample``: at most so many photographs of each campaign, those that persons spoke of first. What a model found in a
    photograph is kept in the lake's cache. Raises InputDataError for the same model twice or an unknown campaign.
    """
    chosen = [_parse_campaign(portfolio, word) for word in dict.fromkeys(campaigns)]
    models = [load_detector(path, threads=1) for path in (old, new)]
    if models[0].sha256 == models[1].sha256:
        raise InputDataError(
            f"{old} and {new} are the same file; give two models (a card alone is tried with evaluate-detector)"
        )
    place = folder or locate_comparison(lake, models[0].sha256, models[1].sha256)
    done = [_compare_on_campaign(building, campaign_id, models, lake, sample) for building, campaign_id in chosen]
    comparison = ModelComparison(
        old=ComparedModel(name=models[0].name, sha256=models[0].sha256),
        new=ComparedModel(name=models[1].name, sha256=models[1].sha256),
        made_at=datetime.now(UTC).replace(microsecond=0),
        facadelake=version_of("facadelake"),
        campaigns=tuple(one.report for one in done),
    )
    write_comparison(comparison, place)
    return ModelComparisonResult(comparison=comparison, folder=place, sheets=_draw_sheets(place, done, comparison))


def _parse_campaign(portfolio: Portfolio, word: str) -> tuple[Building, str]:
    building, slash, campaign_id = word.partition("/")
    if not slash or not building or not campaign_id:
        raise InputDataError(f"--campaign '{word}' is not BUILDING/CAMPAIGN, such as demo/2026-04")
    return portfolio.get_building(building), campaign_id


@dataclass(frozen=True, kw_only=True)
class _CampaignResult:
    report: CampaignComparison
    root: Path
    changes: tuple[BoxChange, ...]
    wall: tuple[DefectChange, ...]
    words: ReviewComparison


def _compare_on_campaign(
    building: Building, campaign_id: str, models: Sequence[OnnxDetector], lake: Path, sample: int | None
) -> _CampaignResult:
    tables = read_committed_tables(building, campaign_id, _TABLES, lake=lake)
    root = building.locate_photographs(campaign_id)
    reviews = reviews_from_table(tables["reviews"])
    chosen, total = _select_photographs(tables["photos"], {word.photo_id for word in reviews}, sample)
    photos = tables["photos"].filter(pa.compute.is_in(tables["photos"].column("photo_id"), pa.array(chosen)))
    model, remark = _read_committed_model(building, campaign_id, tables)
    masks = find_masks(root)
    find_region = (lambda _: SearchRegion()) if model is None else prepare_search_regions(model, tables["poses"], masks)
    run_id = tables["runs"].column("run_id")[0].as_py()
    found = []
    for one in models:
        parts = {
            "model": one.sha256,
            "card": one.card.model_dump(mode="json", exclude={"metrics"}),
            "classes": dict(building.detector.classes),
            "photographs": sorted(photos.column("sha256").to_pylist()),
            "run": run_id,
            "views": model is not None,
            "masks": {photo_id: hash_file(mask) for photo_id, mask in masks.items()},
            "code": compute_code_version(__name__).sha256,
        }
        found.append(
            _detect_cached(lake, compute_key(parts), photos, root, one, building.detector.classes, find_region)
        )
    old, new = (select_accepted_detections(table) for table in found)
    changes = compare_boxes(old, new)
    wall: tuple[DefectChange, ...] = ()
    if model is not None and changes:
        merged = register_on_committed_poses(building, campaign_id, model, join_detections(changes, *found), tables)
        wall = compare_defects(merged.observations, merged.defects)
    words = compare_with_reviews(
        match_reviews(reviews, select_accepted_detections(tables["detections"])), old, new, set(chosen)
    )
    report = CampaignComparison(
        building_id=building.id,
        campaign_id=campaign_id,
        run_id=run_id,
        photographs_total=total,
        photographs=tuple(chosen),
        boxes=count_changes(changes),
        wall=None if model is None else count_changes(wall),
        wall_remark=remark,
        words=words.count_outcomes(),
        lost=list_lost_defects(words),
    )
    return _CampaignResult(report=report, root=root, changes=changes, wall=wall, words=words)


def _select_photographs(photos: pa.Table, spoken_of: Collection[str], sample: int | None) -> tuple[list[str], int]:
    """The photographs to look at and how many there are: those spoken of first, then by the hash of their names."""
    accepted = [row["photo_id"] for row in photos.to_pylist() if row["photo_outcome"] == PhotoOutcome.ACCEPTED]
    order = sorted(accepted, key=lambda one: (one not in spoken_of, hashlib.sha256(one.encode()).hexdigest()))
    return sorted(order[:sample]), len(accepted)


def _read_committed_model(
    building: Building, campaign_id: str, tables: Mapping[str, pa.Table]
) -> tuple[BuildingModel | None, str]:
    """The building's model as it stood, else why there is none: then boxes are compared in photographs alone."""
    try:
        return read_committed_model(building, campaign_id, tables["buildings"].to_pylist()[0]), ""
    except FacadelakeError as error:
        _log.warning("%s %s is compared in photographs alone: %s", building.id, campaign_id, error)
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
    """What a model finds, from the cache where it has looked at these photographs before."""

    def make(folder: Path) -> None:
        workers = len(os.sched_getaffinity(0))
        table = detect_photographs(photos, root, model, class_names=classes, find_region=find_region, workers=workers)
        write_table("detections", table, folder)

    return read_table("detections", open_stage_cache(lake).get_or_make("compare", key, make).folder)


def _draw_sheets(folder: Path, done: Sequence[_CampaignResult], comparison: ModelComparison) -> tuple[Path, ...]:
    """Pictures of what vanishes, appears and is lost, best scores first; a defect of the wall once."""
    names = f"{comparison.old.name} {comparison.old.sha256[:8]} -> {comparison.new.name} {comparison.new.sha256[:8]}"
    drawn = []
    for change in (Change.VANISHES, Change.APPEARS):
        shown = [pair for one in done for pair in _select_boxes(one, change)]
        shown.sort(key=lambda pair: -pair[1].score)
        crops = [_crop_box(one, box) for one, box in shown[:_CROPS_MAX]]
        title = f"{change}: {len(shown)}, the {len(crops)} of the highest scores   {names}"
        drawn.append(write_sheet(folder / f"{change}.png", crops, title=title))
    lost = [(one, word) for one in done for place in one.words.lost for word in place.words[:1]]
    crops = [
        Crop(
            photograph=one.root / word.photo_id,
            box=word.effective_box,
            title=f"{word.defect_class} by {word.reviewer}",
            below=f"{one.report.building_id} {Path(word.photo_id).name}",
        )
        for one, word in lost[:_CROPS_MAX]
    ]
    drawn.append(write_sheet(folder / "lost.png", crops, title=f"confirmed and lost: {len(lost)}   {names}"))
    return tuple(path for path in drawn if path is not None)


def _select_boxes(one: _CampaignResult, wanted: Change) -> list[tuple[_CampaignResult, AcceptedDetection]]:
    """The boxes that a sheet shows: one for each defect of the wall, else each box of the photographs."""
    boxes = [changed.representative for changed in one.changes if changed.change is wanted]
    if one.report.wall is None:
        return [(one, box) for box in boxes]
    by_id = {box.detection_id: box for box in boxes}
    best = []
    for defect in one.wall:
        ours = [by_id[key] for _, key in defect.sightings if key in by_id]
        if defect.change is wanted and ours:
            best.append(max(ours, key=lambda box: box.score))
    return [(one, box) for box in best]


def _crop_box(one: _CampaignResult, box: AcceptedDetection) -> Crop:
    return Crop(
        photograph=one.root / box.photo_id,
        box=box.box,
        title=f"{box.defect_class} {box.score:.2f}",
        below=f"{one.report.building_id} {Path(box.photo_id).name}",
    )
