"""Reviews in the terminal: what was written, what holds, what met nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from facadelake.reviews import Imported, Review, ReviewedCampaign, Task
from schemas.vocabulary import Verdict

_MOST = 10


def show_task(console: Console, task: Task, files: Sequence[Path]) -> None:
    """Where the task is and how it comes back."""
    coco, table, photographs = files
    console.print(
        f"{len(task.shown)} boxes on {len(task.photographs)} photographs of {task.building_id} {task.campaign_id}"
    )
    for path, use in (
        (coco, "open in CVAT or Label Studio (COCO) with the photographs"),
        (photographs, "the photographs to upload there"),
        (table, "or fill in column verdict by hand, a line a defect"),
    ):
        console.print(f"  {path}: {use}", soft_wrap=True, highlight=False)
    console.print(
        f"back with: facadelake review import {task.building_id} {task.campaign_id} FILE --task {coco} --reviewer NAME",
        soft_wrap=True,
        highlight=False,
    )


def show_import(console: Console, done: Imported) -> None:
    """How many words of each verdict, what could not be used, and what they meet."""
    counts = Counter(str(review.verdict) for review in done.words.reviews)
    console.print(", ".join(f"{counts[verdict]} {verdict}" for verdict in Verdict if counts[verdict]))
    if done.added.version is None:
        console.print("nothing new: every word stands in the lake already")
    else:
        console.print(f"{done.added.added} words added in lake version {done.added.version}", end="")
        console.print(f", {done.added.unchanged} stood there already" if done.added.unchanged else "")
    _some(console, f"{len(done.words.remarks)} entries were not used:", done.words.remarks)
    _unmatched(console, done.unmatched)


def show_reviews(console: Console, campaigns: Sequence[ReviewedCampaign], *, lines: bool) -> None:
    """Counts of the words that hold, a line a campaign; with ``lines`` each word."""
    table = RichTable(title="Reviews that hold", title_justify="left")
    table.add_column("building")
    table.add_column("campaign")
    for name in (*Verdict, "not reviewed", "without detection now"):
        table.add_column(str(name), justify="right")
    for campaign in campaigns:
        counts = Counter(one.review.verdict for one in campaign.judgement.standing)
        numbers = [*(counts[verdict] for verdict in Verdict), len(campaign.judgement.unreviewed)]
        table.add_row(
            campaign.building_id, campaign.campaign_id, *map(str, [*numbers, len(campaign.judgement.unmatched)])
        )
    console.print(table)
    for campaign in campaigns if lines else ():
        for one in campaign.judgement.standing:
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
        _unmatched(console, campaign.judgement.unmatched)


def _unmatched(console: Console, reviews: Sequence[Review]) -> None:
    told = [f"{word.verdict} {word.reviewed_class} at {word.subject}" for word in reviews]
    _some(console, f"{len(told)} words are on places where the campaign has no such detection now:", told)


def _some(console: Console, head: str, lines: Sequence[str]) -> None:
    if not lines:
        return
    console.print(head)
    for line in lines[:_MOST]:
        console.print(f"  {escape(line)}", soft_wrap=True, highlight=False)
    if len(lines) > _MOST:
        console.print(f"  and {len(lines) - _MOST} more")
