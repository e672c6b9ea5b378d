"""Changes of size between pairs of detections, each of one defect in two campaigns; significant over all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp, hypot

import numpy as np

from facadelake.core.arrays import RowIndices
from facadelake.tracking.size_change import (
    DefectSizes,
    SizeChange,
    compare_sizes,
    concatenate_sizes,
    select_significant,
)
from schemas.vocabulary import DefectClass, TrendQuantity

# What decides whether a defect has grown; the length of a spall or a damp patch says little that its area does not.
TESTED = {
    DefectClass.CRACK: (TrendQuantity.CRACK_WIDTH, TrendQuantity.LENGTH),
    DefectClass.SPALLING: (TrendQuantity.AREA,),
    DefectClass.MOISTURE: (TrendQuantity.AREA,),
}
# What is told of a change: the area of a crack is that of its box.
SHOWN = {name: (*tested, TrendQuantity.LENGTH) for name, tested in TESTED.items()}


@dataclass(frozen=True, kw_only=True)
class SizeDifference:
    """Change of one size between two detections: the sizes, in the unit of the quantity, and their difference's one
    ``sigma``; ``log_change`` of the logarithm with ``log_sigma``; ``significant`` over the building."""

    before: float
    after: float
    sigma: float
    log_change: float
    log_sigma: float
    significant: bool

    @property
    def change(self) -> float:
        """The change in the unit of the sizes."""
        return self.after - self.before


@dataclass(frozen=True, kw_only=True, eq=False)
class SizedDefects:
    """Classes and sizes of n defects."""

    defect_class: Sequence[DefectClass]
    sizes: Mapping[TrendQuantity, DefectSizes]

    def take(self, rows: RowIndices) -> SizedDefects:
        """The defects of ``rows`` (k,)."""
        return SizedDefects(
            defect_class=[self.defect_class[row] for row in rows.tolist()],
            sizes={quantity: one.take(rows) for quantity, one in self.sizes.items()},
        )


def concatenate_sized(parts: Sequence[SizedDefects]) -> SizedDefects:
    """The defects of all parts, at least one, in their order."""
    return SizedDefects(
        defect_class=[name for part in parts for name in part.defect_class],
        sizes={quantity: concatenate_sizes([part.sizes[quantity] for part in parts]) for quantity in TrendQuantity},
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparedSizes:
    """Changes (k) by quantity, of those that a class is told of, and the scales of ``SizeChange`` by quantity."""

    changes: list[dict[TrendQuantity, SizeDifference]]
    scales: dict[TrendQuantity, float]


def compare_sized_pairs(before: SizedDefects, after: SizedDefects) -> ComparedSizes:
    """Changes of k defects, each detected twice; those that are significant over all of them.

    Of a defect that has changed its class no size is compared: a crack has no area to compare with a spall's. Nor is
    what a class is not told of.
    """
    pairs = list(zip(before.defect_class, after.defect_class, strict=True))
    compared = {}
    for quantity, one in before.sizes.items():
        kept = np.array([name == other and quantity in SHOWN[other] for name, other in pairs], bool)
        sizes = replace(one, log_size=np.where(kept, one.log_size, np.nan))
        compared[quantity] = compare_sizes(sizes, after.sizes[quantity])
    tested = [(k, quantity) for k, name in enumerate(after.defect_class) for quantity in TESTED[name]]
    of_quantity = {quantity: change.p_value for quantity, change in compared.items()}
    p_value = np.array([of_quantity[quantity][k] for k, quantity in tested])
    significant = {pair for pair, yes in zip(tested, select_significant(p_value).tolist(), strict=True) if yes}
    return ComparedSizes(
        changes=[
            {
                quantity: _describe_change(
                    change, k, exp(before.sizes[quantity].log_size[k]), (k, quantity) in significant
                )
                for quantity, change in compared.items()
                if np.isfinite(change.log_change[k])
            }
            for k in range(len(pairs))
        ],
        scales={quantity: change.scale for quantity, change in compared.items()},
    )


def _describe_change(found: SizeChange, row: int, before: float, significant: bool) -> SizeDifference:
    """One of the changes; in the unit of the sizes, an error of either size counts with that size."""
    after = before * exp(found.log_change[row])
    parts = (
        before * found.sigma_before[row],
        after * found.sigma_after[row],
        (before + after) / 2 * found.sigma_common[row],
    )
    return SizeDifference(
        before=before,
        after=after,
        sigma=hypot(*parts),
        log_change=float(found.log_change[row]),
        log_sigma=float(found.sigma[row]),
        significant=significant,
    )


def judge_growth(changes: Mapping[TrendQuantity, SizeDifference]) -> tuple[int, TrendQuantity | None]:
    """1 grown, -1 shrunk, 0 neither, and the quantity that says so most clearly."""
    significant = {quantity: change for quantity, change in changes.items() if change.significant}
    if not significant:
        return 0, None
    decisive = max(significant, key=lambda q: abs(significant[q].log_change) / significant[q].log_sigma)
    return (1 if significant[decisive].log_change > 0 else -1), decisive
