"""The most probable assignment of a campaign's defects to known ones: each at most once, globally optimal.

A pair is worth the log of its odds against both staying unmatched. The probability that a known defect is not found
again and the density of unrelated defects are estimated from the campaigns themselves (expectation-maximisation), so
that no cost is tuned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from facadelake.core.arrays import BoolArray, Float64N, RowIndices
from facadelake.tracking.candidates import CandidatePairs

_ITERATIONS = 5
_FOUND_AGAIN_PRIOR = (4.0, 1.0)  # of the probability to be found again, as counts: found, not found


@dataclass(frozen=True, kw_only=True, eq=False)
class Assignment:
    """Which of the candidate pairs (k) are one defect: ``matched`` (k,), and what speaks for each.

    ``probability`` (k,) that the pair is one defect, among all candidates of both. ``log_odds`` (k,): of the pair
    alone, against two unrelated defects of which one was not found again. ``found_again``: estimated probability that
    a known defect is found; ``density_per_m2`` of unrelated defects.
    """

    matched: BoolArray
    probability: Float64N
    log_odds: Float64N
    found_again: float
    density_per_m2: float


def assign_defects(pairs: CandidatePairs, known_count: int, found_count: int, area_m2: float) -> Assignment:
    """Assign defects of a campaign to known ones.

    Args:
        pairs: the candidates.
        known_count: number of known defects.
        found_count: number of the campaign's defects.
        area_m2: area of the surface on which they lie.

    Returns:
        the assignment of largest posterior probability.
    """
    found_again, density = 0.8, max(found_count, 1) / max(area_m2, 1.0)
    expected = 0.0
    for _ in range(_ITERATIONS):
        odds = np.exp(np.minimum(_compute_log_odds(pairs, found_again, density), 700))
        probability = _compute_marginals(pairs, odds, known_count, found_count)
        expected = float(probability.sum())
        found_again = (expected + _FOUND_AGAIN_PRIOR[0]) / (known_count + sum(_FOUND_AGAIN_PRIOR))
        density = max(found_count - expected, 0.5) / max(area_m2, 1.0)
    log_odds = _compute_log_odds(pairs, found_again, density)
    matched = np.zeros(len(pairs), dtype=bool)
    matched[_maximise(pairs, log_odds, known_count, found_count)] = True
    return Assignment(
        matched=matched,
        probability=_compute_marginals(pairs, np.exp(np.minimum(log_odds, 700)), known_count, found_count),
        log_odds=log_odds,
        found_again=found_again,
        density_per_m2=density,
    )


def _compute_log_odds(pairs: CandidatePairs, found_again: float, density_per_m2: float) -> Float64N:
    """Log odds (k,) of each pair against a known defect that is not found and an unrelated one."""
    odds: Float64N = pairs.log_ratio + np.log(found_again / (1 - found_again)) - np.log(density_per_m2)
    return odds


def _compute_marginals(pairs: CandidatePairs, odds: Float64N, known_count: int, found_count: int) -> Float64N:
    """Probability (k,) of each pair, by belief propagation over the constraint that each defect is matched once.

    Source: Williams and Lau 2014, Approximate evaluation of marginal association probabilities with belief propagation.
    """
    to_known = np.ones(len(pairs))
    for _ in range(30):
        weighted = odds * to_known
        sums = np.bincount(pairs.known, weighted, minlength=known_count)[pairs.known]
        from_known = odds / (1 + sums - weighted)
        sums = np.bincount(pairs.found, from_known, minlength=found_count)[pairs.found]
        to_known = 1 / (1 + sums - from_known)
    weighted = odds * to_known
    marginal: Float64N = weighted / (1 + np.bincount(pairs.known, weighted, minlength=known_count)[pairs.known])
    return marginal


def _maximise(pairs: CandidatePairs, log_odds: Float64N, known_count: int, found_count: int) -> RowIndices:
    """Rows of the pairs that together have the largest log odds; groups that share no candidate are independent."""
    useful = np.flatnonzero(log_odds > 0)
    if not len(useful):
        return useful
    known, found = pairs.known[useful], known_count + pairs.found[useful]
    size = known_count + found_count
    _, group = connected_components(
        coo_array((np.ones(len(useful)), (known, found)), shape=(size, size)), directed=False
    )
    order = np.argsort(group[known], kind="stable")
    bounds = np.flatnonzero(np.diff(group[known][order])) + 1
    chosen: list[int] = []
    for rows in np.split(useful[order], bounds):
        if len(rows) == 1:
            chosen.append(int(rows[0]))
            continue
        first, row_of = np.unique(pairs.known[rows], return_inverse=True)
        second, column_of = np.unique(pairs.found[rows], return_inverse=True)
        gain = np.zeros((len(first), len(second)))
        gain[row_of, column_of] = log_odds[rows]
        pair_at = np.full(gain.shape, -1)
        pair_at[row_of, column_of] = rows
        matched = pair_at[linear_sum_assignment(gain, maximize=True)]
        chosen += matched[matched >= 0].tolist()
    return np.array(sorted(chosen), dtype=np.int64)
