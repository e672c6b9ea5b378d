"""Training sets in the terminal."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console
from rich.table import Table as RichTable

from facadelake.reviews.training import MANIFEST, Split, TrainingSet


def show_training_set(console: Console, done: TrainingSet, placed: Mapping[str, Split]) -> None:
    """A line a split, what was left out, and what is missing to judge a model by."""
    table = RichTable(title="Training set", title_justify="left")
    table.add_column("split")
    table.add_column("buildings")
    counts = {split: done.counts(split) for split in Split}
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
        console.print(f"nothing is of {', '.join(bare)}: no detection there was reviewed")
    empty = [split for split in Split if not counts[split]["pictures"]]
    if empty:
        console.print(
            f"nothing is in {' and '.join(empty)}: a model needs buildings it has not learned from to be judged by; "
            "name more buildings, or choose with --split BUILDING=test",
            soft_wrap=True,
        )
    console.print(f"written to {done.folder}; {MANIFEST} says whence, and under which terms", soft_wrap=True)
