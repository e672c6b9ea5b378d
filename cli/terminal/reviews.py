"""Reviews, training sets and comparisons of models in the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from facadelake.evaluation.model_comparison import REPORT, CampaignComparison, Change, DetectorComparisonResult
from facadelake.reviews import Review, ReviewedCampaign, ReviewImport, ReviewTask
from facadelake.reviews.training import MANIFEST, Split, TrainingSet
from schemas.vocabulary import Verdict

_MOST = 10


def show_task(console: Console, task: ReviewTask, files: Sequence[Path]) -> None:
    """Print the files of a task and the command that imports it."""
    coco, table, photographs = files
    console.print(
        f"{len(task.items)} boxes on {len(task.photographs)} photographs of {task.building_id} {task.campaign_id}"
    )
    for path, use in (
        (coco, "open in CVAT or Label Studio (COCO) with the photographs"),
        (photographs, "the photographs to upload there"),
        (table, "or fill in column verdict by hand, one line per defect"),
    ):
        console.print(f"  {path}: {use}", soft_wrap=True, highlight=False)
    console.print(
        f"then: facadelake review import {task.building_id} {task.campaign_id} FILE --task {coco} --reviewer NAME",
        soft_wrap=True,
        highlight=False,
    )


def show_import(console: Console, done: ReviewImport) -> None:
    """Print the number of reviews by verdict, entries not used, and reviews without a detection."""
    counts = Counter(str(review.verdict) for review in done.parsed.reviews)
    console.print(", ".join(f"{counts[verdict]} {verdict}" for verdict in Verdict if counts[verdict]))
    if done.added.version is None:
        console.print("nothing new: every review is already in the lake")
    else:
        console.print(f"{done.added.added} reviews added in lake version {done.added.version}", end="")
        console.print(f", {done.added.unchanged} were already there" if done.added.unchanged else "")
    _print_some(console, f"{len(done.parsed.remarks)} entries were not used:", done.parsed.remarks)
    _show_unmatched(console, done.unmatched)


def show_reviews(console: Console, campaigns: Sequence[ReviewedCampaign], *, lines: bool) -> None:
    """Print the current reviews by verdict, one line per campaign; with ``lines`` each review."""
    table = RichTable(title="Current reviews", title_justify="left")
    table.add_column("building")
    table.add_column("campaign")
    for name in (*Verdict, "not reviewed", "without detection"):
        table.add_column(str(name), justify="right")
    for campaign in campaigns:
        counts = Counter(one.review.verdict for one in campaign.status.current)
        numbers = [*(counts[verdict] for verdict in Verdict), len(campaign.status.unreviewed)]
        table.add_row(campaign.building_id, campaign.campaign_id, *map(str, [*numbers, len(campaign.status.unmatched)]))
    console.print(table)
    for campaign in campaigns if lines else ():
        for one in campaign.status.current:
            word = one.review
            met = "" if one.detection is None else f" = {one.detection.detection_id}"
            what = word.defect_class or f"no {word.reviewed_class}"
            note = f": {word.note}" if word.note else ""
            console.print(
                f"{word.review_id} {word.verdict} {what} {escape(word.subject)}{escape(met)}, "
                f"{escape(word.reviewer)} {word.reviewed_at:%Y-%m-%d}{escape(note)}",
                soft_wrap=True,
                highlight=False,
            )
    for campaign in campaigns if not lines else ():
        _show_unmatched(console, campaign.status.unmatched)


def _show_unmatched(console: Console, reviews: Sequence[Review]) -> None:
    told = [f"{word.verdict} {word.reviewed_class} at {word.subject}" for word in reviews]
    _print_some(console, f"{len(told)} reviews are of detections that the campaign no longer has:", told)


def _print_some(console: Console, head: str, lines: Sequence[str]) -> None:
    if not lines:
        return
    console.print(head)
    for line in lines[:_MOST]:
        console.print(f"  {escape(line)}", soft_wrap=True, highlight=False)
    if len(lines) > _MOST:
        console.print(f"  and {len(lines) - _MOST} more")


def show_training_set(console: Console, done: TrainingSet, placed: Mapping[str, Split]) -> None:
    """Print one line per split, what was left out, and which splits are empty."""
    table = RichTable(title="Training set", title_justify="left")
    table.add_column("split")
    table.add_column("buildings")
    counts = {split: done.count_by_class(split) for split in Split}
    for name in counts[Split.TRAIN]:
        table.add_column(name, justify="right")
    for split in Split:
        buildings = ", ".join(building for building, one in placed.items() if one is split)
        table.add_row(split, buildings, *(str(number) for number in counts[split].values()))
    console.print(table)
    for reason, number in done.left_out.items():
        console.print(f"left out: {number} {reason}")
    bare = sorted(placed.keys() - {picture.building_id for picture in done.pictures})
    if bare:
        console.print(f"nothing from {', '.join(bare)}: no detection there was reviewed")
    empty = [split for split in Split if not counts[split]["pictures"]]
    if empty:
        console.print(
            f"nothing in {' and '.join(empty)}: a model must be evaluated on buildings it was not trained on; "
            "name more buildings, or assign one with --split BUILDING=test",
            soft_wrap=True,
        )
    console.print(f"written to {done.folder}; {MANIFEST} lists sources and terms of use", soft_wrap=True)


def show_comparison(console: Console, done: DetectorComparisonResult) -> None:
    """Print one line per campaign, place and class, the comparison with reviews, lost defects and the files."""
    comparison = done.comparison
    table = RichTable(
        title=f"{escape(comparison.old.name)} {comparison.old.sha256[:12]} -> "
        f"{escape(comparison.new.name)} {comparison.new.sha256[:12]}",
        title_justify="left",
    )
    for name in ("campaign", "photographs", "where", "class"):
        table.add_column(name)
    for change in Change:
        table.add_column(change, justify="right")
    for campaign in comparison.campaigns:
        _add_rows(table, campaign)
    console.print(table)
    for campaign in comparison.campaigns:
        if campaign.wall is None:
            console.print(
                f"{campaign.building_id}/{campaign.campaign_id} was compared in photographs alone: "
                f"{escape(campaign.wall_remark)}",
                soft_wrap=True,
                highlight=False,
            )
    _print_review_counts(console, comparison.review_counts)
    for one in comparison.lost[:_MOST]:
        console.print(f"  lost: {one.defect} ({one.defect_class}), {one.photo_id}", soft_wrap=True, highlight=False)
    if len(comparison.lost) > _MOST:
        console.print(f"  and {len(comparison.lost) - _MOST} more")
    for path in (done.folder / REPORT, *done.sheets):
        console.print(f"written: {path}", soft_wrap=True, highlight=False)


def _add_rows(table: RichTable, campaign: CampaignComparison) -> None:
    looked = f"{len(campaign.photographs)} of {campaign.photographs_total}"
    for where, counts in (("boxes", campaign.boxes), ("defects on the wall", campaign.wall or {})):
        for defect_class, numbers in counts.items():
            head = (f"{campaign.building_id}/{campaign.campaign_id}", looked, where, defect_class)
            table.add_row(*head, *(str(numbers[change]) for change in Change))


def _print_review_counts(console: Console, words: dict[str, int]) -> None:
    if not words.get("confirmed") and not words.get("rejected"):
        console.print("these photographs have no reviews, so it is unknown which changes are improvements")
        return
    console.print(
        f"of {words['confirmed']} confirmed defects the old finds {words['confirmed_by_old']}, the new "
        f"{words['confirmed_by_new']}: {words['confirmed_lost']} lost, {words['confirmed_gained']} gained; "
        f"of {words['rejected']} rejected boxes the old shows {words['rejected_by_old']}, the new "
        f"{words['rejected_by_new']}: {words['rejected_lost']} gone, {words['rejected_gained']} come",
        soft_wrap=True,
        highlight=False,
    )
