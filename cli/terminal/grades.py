"""What a regrading changes, in the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table as RichTable

from facadelake.lake import Regrading


def show_regrading(console: Console, found: Regrading, releases: Sequence[Path], registered: str | None) -> None:
    """A line for each step from one grade to another, then what stays, the version and where its files are.

    ``registered``: the rule pack that the registry names for the building, None where it is not registered.
    """
    if found.steps:
        table = RichTable(title=f"{found.building_id} graded by {found.rules}", title_justify="left")
        for name in ("campaign", "from", "to", "defects"):
            table.add_column(name, justify="right" if name == "defects" else "left")
        for step in found.steps:
            (word, rule), (new_word, _) = step.before, step.after
            table.add_row(step.campaign_id, f"{word} ({rule})", new_word, str(step.defects))
        console.print(table)
    else:
        console.print(f"nothing changed: every defect of {found.building_id} has its grade by {found.rules} already")
    if found.unchanged and found.steps:
        console.print(f"{found.unchanged} more have this grade already")
    if found.by_persons:
        console.print(f"{found.by_persons} were graded by a person and stay as they are")
    if found.version is None:
        if found.steps:
            console.print("dry run: nothing was written")
        return
    console.print(f"lake version {found.version}; earlier versions stay readable (--as-of)")
    for release in releases:
        console.print(f"files {release}", soft_wrap=True, highlight=False)
    if registered not in (None, found.rules):
        console.print(
            f"the registry grades {found.building_id} by {registered}: a new inspection of changed inputs will, too; "
            f"set severity_rules: {found.rules} there to keep this",
            soft_wrap=True,
        )
