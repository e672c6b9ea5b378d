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
from facadelake.campaigns import committed_model, committed_tables, register_on_committed_poses
from facadelake.core.cache import open_stage_cache
from facadelake.core.code_version import compute_code_version
from facadelake.core.errors import FacadelakeError, InputDataError
from facadelake.core.hashing import compute_key, hash_file
from facadelake.core.tables import read_table, write_table
from facadelake.detection import SearchRegion, detect_photographs
from facadelake.detection.inference import OnnxDetector, load_detector
from facadelake.evaluation.model_comparison.against_reviews import OnWords, against_words
from facadelake.evaluation.model_comparison.changes import Change, Changed, changes_between
from facadelake.evaluation.model_comparison.contact_sheet import Crop, write_sheet
from facadelake.evaluation.model_comparison.defects import WallDefect, joint_detections, wall_defects
from facadelake.evaluation.model_comparison.report import (
    CampaignComparison,
    Comparison,
    ModelNamed,
    comparison_folder,
    counts_of,
    lost_defects,
    write_comparison,
)
from facadelake.photos import find_masks
from facadelake.registration import prepare_building_views
from facadelake.registry import Building, Portfolio
from facadelake.reviews import AcceptedDetection, match_reviews, reviews_from_table, select_accepted_detections
from schemas.vocabulary import PhotoOutcome

log = logging.getLogger("facadelake.flows")

_TABLES = ("runs", "photos", "poses", "georeference", "detections", "observations", "reviews")
_MOST_CROPS = 48  # a sheet


@dataclass(frozen=True, kw_only=True)
class Compared:
    """A comparison, its folder, and the sheets drawn there."""

    comparison: Comparison
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
) -> Compared:
    """Run both models on the photographs of ``campaigns`` (building/campaign) and write what differs.

    ``sample``: at most so many photographs of each campaign, those that persons spoke of first. What a model found in a
    photograph is kept in the lake's cache. Raises InputDataError for the same model twice or an unknown campaign.
    """
    chosen = [_campaign(portfolio, word) for word in dict.fromkeys(campaigns)]
    models = [load_detector(path, threads=1) for path in (old, new)]
    if models[0].sha256 == models[1].sha256:
        raise InputDataError(
            f"{old} and {new} are the same file; give two models (a card alone is tried with evaluate-detector)"
        )
    place = folder or comparison_folder(lake, models[0].sha256, models[1].sha256)
    done = [_compared(building, campaign_id, models, lake, sample) for building, campaign_id in chosen]
    comparison = Comparison(
        old=ModelNamed(name=models[0].name, sha256=models[0].sha256),
        new=ModelNamed(name=models[1].name, sha256=models[1].sha256),
        made_at=datetime.now(UTC).replace(microsecond=0),
        facadelake=version_of("facadelake"),
        campaigns=tuple(one.report for one in done),
    )
    write_comparison(comparison, place)
    return Compared(comparison=comparison, folder=place, sheets=_sheets(place, done, comparison))


def _campaign(portfolio: Portfolio, word: str) -> tuple[Building, str]:
    building, slash, campaign_id = word.partition("/")
    if not slash or not building or not campaign_id:
        raise InputDataError(f"--campaign '{word}' is not BUILDING/CAMPAIGN, such as demo/2026-04")
    return portfolio.building(building), campaign_id


@dataclass(frozen=True, kw_only=True)
class _Done:
    report: CampaignComparison
    root: Path
    changes: tuple[Changed, ...]
    wall: tuple[WallDefect, ...]
    words: OnWords


def _compared(
    building: Building, campaign_id: str, models: Sequence[OnnxDetector], lake: Path, sample: int | None
) -> _Done:
    tables = committed_tables(building, campaign_id, _TABLES, lake=lake)
    root = building.photographs_of(campaign_id)
    reviews = reviews_from_table(tables["reviews"])
    chosen, total = _chosen(tables["photos"], {word.photo_id for word in reviews}, sample)
    photos = tables["photos"].filter(pa.compute.is_in(tables["photos"].column("photo_id"), pa.array(chosen)))
    model, remark = _model(building, campaign_id, tables)
    masks = find_masks(root)
    view_of = (lambda _: SearchRegion()) if model is None else prepare_building_views(model, tables["poses"], masks)
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
        found.append(_found(lake, compute_key(parts), photos, root, one, building.detector.classes, view_of))
    old, new = (select_accepted_detections(table) for table in found)
    changes = changes_between(old, new)
    wall: tuple[WallDefect, ...] = ()
    if model is not None and changes:
        merged = register_on_committed_poses(building, campaign_id, model, joint_detections(changes, *found), tables)
        wall = wall_defects(merged.observations, merged.defects)
    words = against_words(
        match_reviews(reviews, select_accepted_detections(tables["detections"])), old, new, set(chosen)
    )
    report = CampaignComparison(
        building_id=building.id,
        campaign_id=campaign_id,
        run_id=run_id,
        photographs_total=total,
        photographs=tuple(chosen),
        boxes=counts_of(changes),
        wall=None if model is None else counts_of(wall),
        wall_remark=remark,
        words=words.counts(),
        lost=lost_defects(words),
    )
    return _Done(report=report, root=root, changes=changes, wall=wall, words=words)


def _chosen(photos: pa.Table, spoken_of: Collection[str], sample: int | None) -> tuple[list[str], int]:
    """The photographs to look at and how many there are: those spoken of first, then by the hash of their names."""
    accepted = [row["photo_id"] for row in photos.to_pylist() if row["photo_outcome"] == PhotoOutcome.ACCEPTED]
    order = sorted(accepted, key=lambda one: (one not in spoken_of, hashlib.sha256(one.encode()).hexdigest()))
    return sorted(order[:sample]), len(accepted)


def _model(building: Building, campaign_id: str, tables: Mapping[str, pa.Table]) -> tuple[BuildingModel | None, str]:
    """The building's model as it stood, else why there is none: then boxes are compared in photographs alone."""
    try:
        return committed_model(building, campaign_id, tables["buildings"].to_pylist()[0]), ""
    except FacadelakeError as error:
        log.warning("%s %s is compared in photographs alone: %s", building.id, campaign_id, error)
        return None, str(error)


def _found(
    lake: Path,
    key: str,
    photos: pa.Table,
    root: Path,
    model: OnnxDetector,
    classes: Mapping[str, str],
    view_of: Callable[[str], SearchRegion],
) -> pa.Table:
    """What a model finds, from the cache where it has looked at these photographs before."""

    def make(folder: Path) -> None:
        workers = len(os.sched_getaffinity(0))
        table = detect_photographs(photos, root, model, class_names=classes, view_of=view_of, workers=workers)
        write_table("detections", table, folder)

    return read_table("detections", open_stage_cache(lake).get_or_make("compare", key, make).folder)


def _sheets(folder: Path, done: Sequence[_Done], comparison: Comparison) -> tuple[Path, ...]:
    """Pictures of what vanishes, appears and is lost, best scores first; a defect of the wall once."""
    names = f"{comparison.old.name} {comparison.old.sha256[:8]} -> {comparison.new.name} {comparison.new.sha256[:8]}"
    drawn = []
    for change in (Change.VANISHES, Change.APPEARS):
        shown = [pair for one in done for pair in _shown(one, change)]
        shown.sort(key=lambda pair: -pair[1].score)
        crops = [_crop(one, box) for one, box in shown[:_MOST_CROPS]]
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
        for one, word in lost[:_MOST_CROPS]
    ]
    drawn.append(write_sheet(folder / "lost.png", crops, title=f"confirmed and lost: {len(lost)}   {names}"))
    return tuple(path for path in drawn if path is not None)


def _shown(one: _Done, wanted: Change) -> list[tuple[_Done, AcceptedDetection]]:
    """The boxes that a sheet shows: one for each defect of the wall, else each box of the photographs."""
    boxes = [changed.shown for changed in one.changes if changed.change is wanted]
    if one.report.wall is None:
        return [(one, box) for box in boxes]
    by_id = {box.detection_id: box for box in boxes}
    best = []
    for defect in one.wall:
        ours = [by_id[key] for _, key in defect.sightings if key in by_id]
        if defect.change is wanted and ours:
            best.append(max(ours, key=lambda box: box.score))
    return [(one, box) for box in best]


def _crop(one: _Done, box: AcceptedDetection) -> Crop:
    return Crop(
        photograph=one.root / box.photo_id,
        box=box.box,
        title=f"{box.defect_class} {box.score:.2f}",
        below=f"{one.report.building_id} {Path(box.photo_id).name}",
    )
