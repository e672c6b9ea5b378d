"""What two models find differently, in the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from facadelake.evaluation.model_comparison import REPORT, CampaignComparison, Change, Compared

_MOST = 10


def show_comparison(console: Console, done: Compared) -> None:
    """A line for each campaign, place and class; what persons said; what is lost; where pictures are."""
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
        _rows(table, campaign)
    console.print(table)
    for campaign in comparison.campaigns:
        if campaign.wall is None:
            console.print(
                f"{campaign.building_id}/{campaign.campaign_id} was compared in photographs alone: "
                f"{escape(campaign.wall_remark)}",
                soft_wrap=True,
                highlight=False,
            )
    _words(console, comparison.words)
    for one in comparison.lost[:_MOST]:
        console.print(f"  lost: {one.defect} ({one.defect_class}), {one.photo_id}", soft_wrap=True, highlight=False)
    if len(comparison.lost) > _MOST:
        console.print(f"  and {len(comparison.lost) - _MOST} more")
    for path in (done.folder / REPORT, *done.sheets):
        console.print(f"written: {path}", soft_wrap=True, highlight=False)


def _rows(table: RichTable, campaign: CampaignComparison) -> None:
    looked = f"{len(campaign.photographs)} of {campaign.photographs_total}"
    for where, counts in (("boxes", campaign.boxes), ("defects on the wall", campaign.wall or {})):
        for defect_class, numbers in counts.items():
            head = (f"{campaign.building_id}/{campaign.campaign_id}", looked, where, defect_class)
            table.add_row(*head, *(str(numbers[change]) for change in Change))


def _words(console: Console, words: dict[str, int]) -> None:
    if not words.get("confirmed") and not words.get("rejected"):
        console.print("nobody has reviewed these photographs, so that nothing tells which changes are good")
        return
    console.print(
        f"of {words['confirmed']} confirmed defects the old finds {words['confirmed_by_old']}, the new "
        f"{words['confirmed_by_new']}: {words['confirmed_lost']} lost, {words['confirmed_gained']} gained; "
        f"of {words['rejected']} rejected boxes the old shows {words['rejected_by_old']}, the new "
        f"{words['rejected_by_new']}: {words['rejected_lost']} gone, {words['rejected_gained']} come",
        soft_wrap=True,
        highlight=False,
    )
