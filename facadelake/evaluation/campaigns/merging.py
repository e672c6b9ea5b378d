"""Deduplication against truth: precision and recall of the pairs of observations in one defect."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import comb


@dataclass(frozen=True, kw_only=True)
class MergeFigures:
    """Precision, recall and F1 of pairs of observations in one defect; None where the denominator is 0.

    ``clusters_exact``: share of true defects whose observations are all in one defect, which has no other.
    """

    precision: float | None
    recall: float | None
    f1: float | None
    clusters_exact: float | None

    def convert_to_json(self) -> dict[str, float | None]:
        """The fields as keys."""
        return {
            "precision": self.precision,
            "recall": self.recall,
            "f1": self.f1,
            "clusters_exact": self.clusters_exact,
        }


def compute_merge_figures(decisions: Sequence[tuple[str, str]]) -> MergeFigures:
    """Compare the decisions on registered observations, each as (decided defect, true defect), with truth."""
    correct = _count_pairs(Counter(decisions).values())
    decided = _count_pairs(Counter(defect for defect, _ in decisions).values())
    true = _count_pairs(Counter(truth for _, truth in decisions).values())
    of_truth: dict[str, set[int]] = defaultdict(set)
    of_defect: dict[str, set[int]] = defaultdict(set)
    for i, (defect, truth) in enumerate(decisions):
        of_truth[truth].add(i)
        of_defect[defect].add(i)
    clusters = {frozenset(members) for members in of_defect.values()}
    exact = sum(frozenset(members) in clusters for members in of_truth.values())
    return MergeFigures(
        precision=_compute_share(correct, decided),
        recall=_compute_share(correct, true),
        f1=_compute_share(2 * correct, decided + true),
        clusters_exact=_compute_share(exact, len(of_truth)),
    )


def _count_pairs(sizes: Iterable[int]) -> int:
    return sum(comb(size, 2) for size in sizes)


def _compute_share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
