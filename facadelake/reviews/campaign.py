"""Reviews of committed campaigns: tasks for persons, their words into the lake, and what holds after them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import pyarrow as pa

from facadelake.campaigns import read_committed_tables
from facadelake.core.errors import InputDataError
from facadelake.detection import build_crosswalk
from facadelake.lake import AppendResult, append_reviews, read_table
from facadelake.registry import Building
from facadelake.reviews.coco_import import ParsedReviews, read_coco_reviews
from facadelake.reviews.csv_import import read_csv_reviews
from facadelake.reviews.review import Review, reviews_from_table, table_from_reviews
from facadelake.reviews.review_items import ReviewItem, ReviewProvenance, list_review_items
from facadelake.reviews.review_matching import ReviewStatus, match_reviews, select_accepted_detections
from facadelake.reviews.task_files import ReviewTask, build_coco_task, format_defects_csv, read_task, write_task
from schemas.vocabulary import PhotoOutcome

_TABLES = ("runs", "photos", "detections", "observations", "defects", "reviews")


@dataclass(frozen=True, kw_only=True)
class ReviewedCampaign:
    """A committed campaign and its detections as persons left them.

    ``sizes``: (width, height) in px of the accepted photographs, by photo_id.
    """

    building_id: str
    campaign_id: str
    run_id: str
    tables: Mapping[str, pa.Table]
    sizes: Mapping[str, tuple[int, int]]
    status: ReviewStatus
    items: tuple[ReviewItem, ...]


@dataclass(frozen=True, kw_only=True)
class ReviewImport:
    """What became of a file of words: as they were read, as the lake took them, and words that now meet nothing."""

    parsed: ParsedReviews
    added: AppendResult
    unmatched: tuple[Review, ...]


def read_reviewed_campaign(building: Building, campaign_id: str, *, lake: Path) -> ReviewedCampaign:
    """The campaign and what holds of its detections. Raises StoreError where the lake does not have it."""
    tables = read_committed_tables(building, campaign_id, _TABLES, lake=lake)
    seen_as = tables["observations"].select(["detection_id", "defect_id"]).to_pylist()
    judgement = match_reviews(reviews_from_table(tables["reviews"]), select_accepted_detections(tables["detections"]))
    return ReviewedCampaign(
        building_id=building.id,
        campaign_id=campaign_id,
        run_id=tables["runs"].column("run_id")[0].as_py(),
        tables=tables,
        sizes={
            row["photo_id"]: (row["image_width_px"], row["image_height_px"])
            for row in tables["photos"].to_pylist()
            if row["photo_outcome"] == PhotoOutcome.ACCEPTED
        },
        status=judgement,
        items=list_review_items(
            judgement, {row["detection_id"]: row["defect_id"] for row in seen_as if row["defect_id"]}
        ),
    )


def export_task(
    building: Building,
    campaign_id: str,
    folder: Path,
    *,
    lake: Path,
    photographs: Sequence[str],
    only_unreviewed: bool,
    score_min: float,
) -> tuple[ReviewTask, tuple[Path, Path, Path]]:
    """Write a task: the places shown on ``photographs`` (empty: on all), from ``score_min`` on.

    ``only_unreviewed`` keeps the photographs that have a detection nobody has spoken of. Returns the task and its
    files: COCO, CSV, list of photographs. Raises InputDataError where nothing is left to show.
    """
    campaign = read_reviewed_campaign(building, campaign_id, lake=lake)
    unknown = sorted(set(photographs) - campaign.sizes.keys())
    if unknown:
        raise InputDataError(
            f"{building.id} {campaign_id} has no accepted photograph {', '.join(unknown)}; give the photo_id, such as "
            f"{next(iter(campaign.sizes), 'multiview/IMG_1.JPG')}"
        )
    open_photographs = {one.photo_id for one in campaign.status.unreviewed if one.score >= score_min}
    chosen = [
        photo_id
        for photo_id in sorted(campaign.sizes)
        if photo_id in (photographs or campaign.sizes) and (not only_unreviewed or photo_id in open_photographs)
    ]
    if not chosen:
        raise InputDataError(
            f"every detection of {building.id} {campaign_id} with a score of {score_min:g} or more has been reviewed; "
            "leave out --unreviewed to look again"
        )
    shown = tuple(
        place
        for place in campaign.items
        if place.is_defect and place.photo_id in set(chosen) and place.score >= score_min
    )
    task = ReviewTask(
        building_id=building.id,
        campaign_id=campaign_id,
        run_id=campaign.run_id,
        photographs=tuple(chosen),
        items=shown,
    )
    root = building.locate_photographs(campaign_id)
    sightings: dict[str, list[ReviewItem]] = defaultdict(list)
    for place in shown:
        if place.defect_id is not None:
            sightings[place.defect_id].append(place)
    files = write_task(
        folder,
        build_coco_task(task, campaign.sizes, photographs_uri=str(root)),
        format_defects_csv(task, campaign.tables["defects"].to_pylist(), sightings),
        [root / photo_id for photo_id in chosen],
    )
    return task, files


def import_reviews(
    building: Building, campaign_id: str, file: Path, *, lake: Path, reviewer: str, task: Path | None
) -> ReviewImport:
    """Read the words of a CSV or COCO file and add them to the lake.

    With the ``task`` that was exported, boxes deleted from a COCO file are rejected; without, only what the file holds
    counts. Raises InputDataError where the file, or the task, does not fit the campaign.
    """
    if not reviewer.strip():
        raise InputDataError("a review needs the name of who says it; give --reviewer")
    campaign = read_reviewed_campaign(building, campaign_id, lake=lake)
    shown = _read_task_of_campaign(task, campaign) if task else None
    run_id = shown.run_id if shown else campaign.run_id
    said = ReviewProvenance(reviewer=reviewer.strip(), reviewed_at=datetime.now(UTC), run_id=run_id)
    crosswalk = build_crosswalk(building.detector.classes)
    kind = file.suffix.lower()
    if kind == ".csv":
        words = read_csv_reviews(file, campaign.items, campaign.sizes, crosswalk, said)
    elif kind == ".json":
        places = _select_items(shown, campaign) if shown else campaign.items
        words = read_coco_reviews(file, places, campaign.sizes, crosswalk, said, deletions_count=shown is not None)
    else:
        raise InputDataError(f"{file} is neither a .csv nor a COCO .json; 'facadelake review export-task' writes both")
    if not words.reviews:
        told = "; ".join(words.remarks[:5]) or "no line has a verdict"
        raise InputDataError(f"{file} holds no word that can be used: {told}")
    table = table_from_reviews(words.reviews, building_id=building.id, campaign_id=campaign_id)
    added = append_reviews(lake, table, building_id=building.id, campaign_id=campaign_id)
    reviews = reviews_from_table(read_table(lake, "reviews", building_id=building.id, campaign_id=campaign_id))
    after = match_reviews(reviews, select_accepted_detections(campaign.tables["detections"]))
    return ReviewImport(parsed=words, added=added, unmatched=after.unmatched)


def _read_task_of_campaign(path: Path, campaign: ReviewedCampaign) -> ReviewTask:
    task = read_task(path)
    if (task.building_id, task.campaign_id) != (campaign.building_id, campaign.campaign_id):
        raise InputDataError(
            f"{path} is a task of {task.building_id} {task.campaign_id}, not of {campaign.building_id} "
            f"{campaign.campaign_id}; name the campaign that was reviewed"
        )
    return task


def _select_items(task: ReviewTask, campaign: ReviewedCampaign) -> tuple[ReviewItem, ...]:
    """What the task showed, and what it did not because it is rejected: a person may draw it again."""
    shown = {place.subject for place in task.items}
    return (*task.items, *(place for place in campaign.items if not place.is_defect and place.subject not in shown))
