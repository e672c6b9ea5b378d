"""Reviews of committed campaigns: export of review tasks, import of reviews into the lake, status of a campaign."""

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
from facadelake.detection.coco import StoredImage
from facadelake.lake import AppendResult, append_reviews, read_table
from facadelake.registry import Building
from facadelake.reviews.coco_import import read_coco_reviews
from facadelake.reviews.csv_import import read_csv_reviews
from facadelake.reviews.review import ParsedReviews, Review, reviews_from_table, table_from_reviews
from facadelake.reviews.review_items import ReviewItem, ReviewProvenance, list_review_items
from facadelake.reviews.review_matching import ReviewStatus, match_reviews, select_accepted_detections
from facadelake.reviews.task_files import ReviewTask, build_coco_task, format_defects_csv, read_task, write_task
from schemas.vocabulary import PhotoOutcome

_TABLES = ("runs", "photos", "detections", "observations", "defects", "reviews")


@dataclass(frozen=True, kw_only=True)
class ReviewedCampaign:
    """A committed campaign with its reviews.

    ``sizes``: (width, height) in px of the accepted photographs, by photo_id. ``items``: all reviewed or detected
    locations.
    """

    building_id: str
    campaign_id: str
    run_id: str
    tables: Mapping[str, pa.Table]
    sizes: Mapping[str, tuple[int, int]]
    status: ReviewStatus
    items: tuple[ReviewItem, ...]

    def list_stored_images(self) -> dict[str, StoredImage]:
        """Size and EXIF orientation of the accepted photographs, by photo_id."""
        orientation = {row["photo_id"]: row["exif_orientation"] or 1 for row in self.tables["photos"].to_pylist()}
        return {
            photo_id: StoredImage(width_px=width, height_px=height, orientation=orientation[photo_id])
            for photo_id, (width, height) in self.sizes.items()
        }


@dataclass(frozen=True, kw_only=True)
class ReviewImport:
    """The import of a file of reviews: the reviews read, those added to the lake, and current ones of the campaign that
    match no detection."""

    parsed: ParsedReviews
    added: AppendResult
    unmatched: tuple[Review, ...]


def read_reviewed_campaign(
    building: Building, campaign_id: str, *, lake: Path, as_of: int | None = None
) -> ReviewedCampaign:
    """Read a campaign with its reviews from the lake, at version ``as_of`` (None: the newest).

    Raises StoreError where the lake does not hold the campaign.
    """
    tables = read_committed_tables(building, campaign_id, _TABLES, lake=lake, as_of=as_of)
    observations = tables["observations"].select(["detection_id", "defect_id"]).to_pylist()
    status = match_reviews(reviews_from_table(tables["reviews"]), select_accepted_detections(tables["detections"]))
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
        status=status,
        items=list_review_items(
            status, {row["detection_id"]: row["defect_id"] for row in observations if row["defect_id"]}
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
    as_of: int | None = None,
) -> tuple[ReviewTask, tuple[Path, Path, Path]]:
    """Write a review task: the defects of a campaign for reviewers.

    Args:
        building: The registered building.
        campaign_id: A committed campaign.
        folder: Folder of the task's files; it must not hold a task already.
        lake: Folder of the lake.
        photographs: photo_id of the photographs to review; empty: all accepted ones.
        only_unreviewed: Only photographs with a detection without a review.
        score_min: Leave out detections of a lower score (0 to 1).
        as_of: An earlier version of the lake; None: the newest.

    Returns:
        The task and its files: COCO, CSV, list of photographs.

    Raises:
        InputDataError: A photograph is unknown, or no photograph is left to review.
        StoreError: The lake does not hold the campaign.
    """
    campaign = read_reviewed_campaign(building, campaign_id, lake=lake, as_of=as_of)
    unknown = sorted(set(photographs) - campaign.sizes.keys())
    if unknown:
        raise InputDataError(
            f"{building.id} {campaign_id} has no accepted photograph {', '.join(unknown)}; give a photo_id, such as "
            f"{next(iter(campaign.sizes), 'multiview/IMG_1.JPG')}"
        )
    unreviewed_photographs = {one.photo_id for one in campaign.status.unreviewed if one.score >= score_min}
    chosen = [
        photo_id
        for photo_id in sorted(campaign.sizes)
        if photo_id in (photographs or campaign.sizes) and (not only_unreviewed or photo_id in unreviewed_photographs)
    ]
    if not chosen:
        raise InputDataError(
            f"every detection of {building.id} {campaign_id} with a score of {score_min:g} or more has been reviewed; "
            "leave out --unreviewed to export them again"
        )
    items = tuple(
        item for item in campaign.items if item.is_defect and item.photo_id in set(chosen) and item.score >= score_min
    )
    task = ReviewTask(
        building_id=building.id,
        campaign_id=campaign_id,
        run_id=campaign.run_id,
        photographs=tuple(chosen),
        items=items,
    )
    root = building.locate_photographs(campaign_id)
    items_by_defect: dict[str, list[ReviewItem]] = defaultdict(list)
    for item in items:
        if item.defect_id is not None:
            items_by_defect[item.defect_id].append(item)
    files = write_task(
        folder,
        build_coco_task(task, campaign.sizes, photographs_uri=str(root)),
        format_defects_csv(task, campaign.tables["defects"].to_pylist(), items_by_defect),
        [root / photo_id for photo_id in chosen],
    )
    return task, files


def import_reviews(
    building: Building, campaign_id: str, file: Path, *, lake: Path, reviewer: str, task: Path | None
) -> ReviewImport:
    """Read the reviews of a CSV or COCO file and add them to the lake.

    Args:
        building: The registered building.
        campaign_id: The reviewed campaign.
        file: The filled-in table (.csv) or the corrected COCO file (.json).
        lake: Folder of the lake.
        reviewer: The reviewer's name.
        task: The COCO file as it was exported: a box that a corrected COCO file lacks is rejected. None: it has no
            review.

    Returns:
        The reviews read and added, and the current ones that match no detection.

    Raises:
        InputDataError: The file or the task does not fit the campaign, or the file holds no usable review.
        StoreError: The lake does not hold the campaign.
    """
    if not reviewer.strip():
        raise InputDataError("a review needs the reviewer's name; give --reviewer")
    campaign = read_reviewed_campaign(building, campaign_id, lake=lake)
    exported = _read_task_of_campaign(task, campaign) if task else None
    run_id = exported.run_id if exported else campaign.run_id
    provenance = ReviewProvenance(reviewer=reviewer.strip(), reviewed_at=datetime.now(UTC), run_id=run_id)
    crosswalk = build_crosswalk(building.detector.classes)
    suffix = file.suffix.lower()
    if suffix == ".csv":
        parsed = read_csv_reviews(file, campaign.items, campaign.sizes, crosswalk, provenance)
    elif suffix == ".json":
        items = _select_items(exported, campaign) if exported else campaign.items
        parsed = read_coco_reviews(
            file, items, campaign.list_stored_images(), crosswalk, provenance, deletions_count=exported is not None
        )
    else:
        raise InputDataError(f"{file} is neither a .csv nor a COCO .json; 'facadelake review export-task' writes both")
    if not parsed.reviews:
        reasons = "; ".join(parsed.remarks[:5]) or "no line has a verdict"
        raise InputDataError(f"{file} holds no usable review: {reasons}")
    table = table_from_reviews(parsed.reviews, building_id=building.id, campaign_id=campaign_id)
    added = append_reviews(lake, table, building_id=building.id, campaign_id=campaign_id)
    reviews = reviews_from_table(read_table(lake, "reviews", building_id=building.id, campaign_id=campaign_id))
    status = match_reviews(reviews, select_accepted_detections(campaign.tables["detections"]))
    return ReviewImport(parsed=parsed, added=added, unmatched=status.unmatched)


def _read_task_of_campaign(path: Path, campaign: ReviewedCampaign) -> ReviewTask:
    task = read_task(path)
    if (task.building_id, task.campaign_id) != (campaign.building_id, campaign.campaign_id):
        raise InputDataError(
            f"{path} is a task of {task.building_id} {task.campaign_id}, not of {campaign.building_id} "
            f"{campaign.campaign_id}; give the campaign that was reviewed"
        )
    return task


def _select_items(task: ReviewTask, campaign: ReviewedCampaign) -> tuple[ReviewItem, ...]:
    """The task's items, and the rejected ones of the campaign: a reviewer may draw those again."""
    exported = {item.subject for item in task.items}
    return (*task.items, *(item for item in campaign.items if not item.is_defect and item.subject not in exported))
