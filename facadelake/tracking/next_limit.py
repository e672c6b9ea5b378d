"""When a trend reaches the next limit of a rule pack: the pack itself is asked, with larger and larger sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from facadelake.core.arrays import Float64N
from facadelake.severity import grade_defects, read_rule_pack
from schemas.vocabulary import TrendQuantity

_ALONG = {TrendQuantity.LENGTH: 1.0, TrendQuantity.AREA: 0.5}
# How the columns of a defect grow with one of its sizes: as its power.
_EXPONENTS: dict[str, dict[TrendQuantity, float]] = {
    "crack_width_mm": {TrendQuantity.CRACK_WIDTH: 1.0},
    "crack_width_max_mm": {TrendQuantity.CRACK_WIDTH: 1.0},
    "length_m": _ALONG,
    "width_m": _ALONG,
    "height_m": _ALONG,
    "area_m2": {TrendQuantity.LENGTH: 1.0, TrendQuantity.AREA: 1.0},
}
_FACTOR_MAX, _COARSE_STEPS, _FINE_STEPS = 20.0, 100, 40
# The last pass has steps of 2e-5 of the size, so that a limit of a rule pack is met to these significant digits.
_PASSES, _DIGITS = 3, 4


@dataclass(frozen=True, kw_only=True)
class NextLimit:
    """The smallest ``size`` of a quantity, in its unit, at which a rule pack gives a worse ``severity``."""

    size: float
    severity: str


def find_next_limits(defects: pa.Table, quantities: Sequence[TrendQuantity], rule_file: Path) -> list[NextLimit | None]:
    """The next limit of each defect when one of its sizes grows; None where twenty times the size changes nothing.

    Args:
        defects: rows of table ``defects``.
        quantities: the size that grows, of each.
        rule_file: the rule pack.
    """
    count = len(defects)
    steps = np.tile(np.geomspace(1.0, _FACTOR_MAX, _COARSE_STEPS), (count, 1))
    found: list[tuple[int, str | None]] = [(0, None)] * count
    for _ in range(_PASSES):
        found = _find_worse(defects, quantities, np.concatenate([np.ones((count, 1)), steps], axis=1), rule_file)
        factor = np.array([steps[row, step - 1] if step else 1.0 for row, (step, _) in enumerate(found)])
        below = np.array([steps[row, step - 2] if step > 1 else 1.0 for row, (step, _) in enumerate(found)])
        steps = np.geomspace(below, factor, _FINE_STEPS, axis=1)
    limits: list[NextLimit | None] = []
    for row, (step, severity) in enumerate(found):
        size = defects.column(quantities[row])[row].as_py()
        known = step > 0 and severity is not None and size is not None
        limit = float(f"{size * factor[row]:.{_DIGITS}g}") if known else 0.0
        limits.append(NextLimit(size=limit, severity=str(severity)) if known else None)
    return limits


def _find_worse(
    defects: pa.Table, quantities: Sequence[TrendQuantity], factors: Float64N, rule_file: Path
) -> list[tuple[int, str | None]]:
    """The first column of ``factors`` (n, k) that each defect is graded worse for than for the first; 0: none."""
    ranks = {word: rank for rank, word in enumerate(read_rule_pack(rule_file.stem, rule_file.parent).severities)}
    steps = factors.shape[1]
    larger = defects.take(np.repeat(np.arange(len(defects)), steps))
    for name, exponent in _EXPONENTS.items():
        by_row = np.repeat([exponent.get(quantity, 0.0) for quantity in quantities], steps)
        scaled = pc.multiply(larger.column(name), pa.array(factors.ravel() ** by_row))
        larger = larger.set_column(larger.column_names.index(name), larger.schema.field(name), scaled)
    ids = pa.array([f"{place}|{step}" for place in range(len(defects)) for step in range(steps)])
    larger = larger.set_column(larger.column_names.index("defect_id"), larger.schema.field("defect_id"), ids)
    words = np.array(grade_defects(larger, rule_file).column("severity").to_pylist(), dtype=object)
    words = words.reshape(factors.shape)
    found: list[tuple[int, str | None]] = []
    for line in words:
        worse = [step for step, word in enumerate(line) if ranks[word] < ranks[line[0]]]
        found.append((worse[0], line[worse[0]]) if worse else (0, None))
    return found
