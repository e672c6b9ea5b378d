"""The true track states: what an observer without error could say of each defect after each campaign.

The rule, with the words of the product (new, first_seen, seen, grown, shrunk, repaired, not_imaged, reopened):

- A place is imaged where at least one photograph shows it well enough for a box: within 75 degrees of the wall's
  normal, 60 % of it visible, and at least 4 by 10 pixels, at the size of that day (at factor 1 where nothing is there).
- Empty before the first campaign that shows the defect: it does not exist yet, or nobody can have seen it.
- That first campaign: ``new`` where an earlier one imaged the place, which then was without it; otherwise
  ``first_seen``, of unknown age.
- Later, a place that is not imaged is ``not_imaged``, whatever is there.
- Imaged and gone is ``repaired``: in the campaign that finds it gone, and in each later one as long as it stays gone.
- Imaged and there is ``reopened`` where the last campaign that imaged it found it gone; otherwise ``grown`` or
  ``shrunk`` where the recipe changes its size between that campaign and this one, and ``seen`` where it does not. A
  crack that spalls without a change of size is ``seen``; its class is another.

``not_found`` is never true: it is what is said of a defect that is there, imaged, and was not found.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from facadelake.demo.defect_recipe import DefectOnDay
from facadelake.demo.recipe import DemoRecipe


@dataclass(frozen=True, kw_only=True)
class ImagedDefect:
    """A defect on the day of a campaign, and the number of photographs that show it or its place."""

    day: DefectOnDay
    photographs: int


def derive_track_state(history: Sequence[ImagedDefect]) -> str:
    """The true track state after the last campaign of a history; empty where nobody can have seen the defect."""
    *earlier, now = history
    seen = [one for one in earlier if one.day.exists and one.photographs]
    if not seen:
        if not (now.day.exists and now.photographs):
            return ""
        return "new" if any(one.photographs for one in earlier) else "first_seen"
    if not now.photographs:
        return "not_imaged"
    if not now.day.exists:
        return "repaired"
    before = next(one.day for one in reversed(earlier) if one.photographs)
    if not before.exists:
        return "reopened"
    change = now.day.width_m * now.day.height_m - before.width_m * before.height_m
    return "grown" if change > 0 else "shrunk" if change < 0 else "seen"


def write_history(recipe: DemoRecipe, out: Path) -> None:
    """``truth/defects.csv``: a row a defect, with its states, track states and classes by campaign.

    They are gathered from ``defects.csv`` of each campaign in ``out``.
    """
    columns = ("state", "track_state", "class")
    rows: dict[str, dict[str, str]] = {d.id: {"id": d.id, "class": d.kind} for d in recipe.defects}
    for campaign in recipe.campaigns:
        with (out / "campaigns" / campaign.id / "truth" / "defects.csv").open(newline="", encoding="utf-8") as stream:
            for row in csv.DictReader(stream):
                rows[row["id"]] |= {f"{name}_{campaign.id}": row[name] for name in columns}
    (out / "truth").mkdir()
    header = ["id", "class", *(f"{name}_{c.id}" for name in columns for c in recipe.campaigns)]
    with (out / "truth" / "defects.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, header, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows.values())
