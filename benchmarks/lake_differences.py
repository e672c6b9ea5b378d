"""Compare the tables of two lakes row by row: proof that a change of the code left the results as they were.

    .venv/bin/python -m benchmarks.lake_differences BEFORE AFTER [--building demo]

Rows are matched by the table's key. For each column with differences it prints how many rows differ, and the largest
difference of a number (also within lists) or the first pair of other values. A lake of an earlier schema is read with
the current columns.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from facadelake.lake import read_table
from schemas.tables import LAKE_TABLES, Table

_OF_EACH_RUN = frozenset({"run_id", "started_at", "finished_at", "stage_seconds", "stage_peak_mib", "stage_keys"})
_TEXT_LENGTH = 100


def list_differences(table: Table, before: Path, after: Path, building_id: str | None) -> Iterator[str]:
    """One line for the table, then one per column with differences."""
    rows = [read_table(lake, table.name, building_id=building_id).to_pylist() for lake in (before, after)]
    key = [name for name in table.key if name not in _OF_EACH_RUN]
    indexed = [{tuple(row[name] for name in key): row for row in each} for each in rows]
    common = sorted(indexed[0].keys() & indexed[1].keys(), key=str)
    lines = []
    for column in (column.name for column in table.columns if column.name not in _OF_EACH_RUN):
        pairs = [(indexed[0][k][column], indexed[1][k][column]) for k in common]
        differing = [pair for pair in pairs if not _is_equal(*pair)]
        if differing:
            lines.append(f"    {column}: {len(differing)} rows, {_describe(differing)}")
    only = [len(each) - len(common) for each in indexed]
    yield (
        f"{table.name}: {len(rows[0])} rows before, {len(rows[1])} after; {only[0]} only before, {only[1]} only after; "
        f"{len(lines)} of {len(table.columns)} columns with differences"
    )
    yield from lines


def _is_equal(a: Any, b: Any) -> bool:
    return a == b or (isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b))


def _describe(differing: Sequence[tuple[Any, Any]]) -> str:
    largest = [_measure_difference(*pair) for pair in differing]
    numbers = [value for value in largest if value is not None]
    if len(numbers) == len(differing):
        return f"largest difference {max(numbers):.3g}"
    first = next(pair for pair, value in zip(differing, largest, strict=True) if value is None)
    return " -> ".join(str(value)[:_TEXT_LENGTH] for value in first)


def _measure_difference(a: Any, b: Any) -> float | None:
    """Largest absolute difference of two numbers, or of two lists of numbers; None if they are something else."""
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        parts = [_measure_difference(*pair) for pair in zip(a, b, strict=True)]
        return None if None in parts else max((part for part in parts if part is not None), default=0.0)
    if isinstance(a, int | float) and isinstance(b, int | float):
        return abs(a - b)
    return None


def main() -> None:
    """Compare all tables of the lake."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path, help="folder of a lake")
    parser.add_argument("after", type=Path, help="folder of the other lake")
    parser.add_argument("--building", help="only this building")
    chosen = parser.parse_args()
    for table in LAKE_TABLES.values():
        for line in list_differences(table, chosen.before, chosen.after, chosen.building):
            print(line)


if __name__ == "__main__":
    main()
