"""Check points against defects: which were missed, which were found twice, which defects show none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from facadelake.core.arrays import Float64Array

# The paper's Algorithm 1 takes detections nearer than this for one; neighbours inside it are the ones it would merge.
NEAR_DISTANCE_M = 0.5


@dataclass(frozen=True, kw_only=True)
class CheckPointCounts:
    """Counts over the check points of truth.

    ``total`` of them; ``detected``: an accepted detection shows them; ``missed``: no defect shows them, ``lost`` of
    these were detected; ``duplicated``: more than one defect shows them; ``false_defects``: defects most of whose
    sightings show none. ``near_pairs``: pairs of found check points less than 0.5 m apart, ``near_apart`` of which no
    defect holds sightings of both; ``nearest_apart_m`` the smallest distance that was kept apart.
    """

    total: int
    detected: int
    missed: int
    lost: int
    duplicated: int
    false_defects: int
    near_pairs: int
    near_apart: int
    nearest_apart_m: float | None

    def to_json(self) -> dict[str, float | int | None]:
        """The fields as keys."""
        return asdict(self)


def count_check_points(
    *,
    xyz_true_site_m: Mapping[str, Float64Array],
    detected: Iterable[str],
    shown_by_defect: Sequence[str | None],
    members: Sequence[tuple[str, str]],
) -> CheckPointCounts:
    """The counts.

    ``detected``: check points of accepted detections. ``shown_by_defect``: the check point of each defect, None for
    one that shows none. ``members``: registered sightings as (defect, check point).
    """
    found = Counter(target for target in shown_by_defect if target is not None)
    seen = set(detected)
    missed = [name for name in xyz_true_site_m if name not in found]
    pairs = _find_near_pairs(sorted({target for _, target in members}), xyz_true_site_m)
    together = _find_merged_pairs(members)
    apart = [distance for distance, pair in pairs if pair not in together]
    return CheckPointCounts(
        total=len(xyz_true_site_m),
        detected=len(seen),
        missed=len(missed),
        lost=sum(name in seen for name in missed),
        duplicated=sum(times > 1 for times in found.values()),
        false_defects=sum(target is None for target in shown_by_defect),
        near_pairs=len(pairs),
        near_apart=len(apart),
        nearest_apart_m=min(apart, default=None),
    )


def _find_near_pairs(names: Sequence[str], xyz: Mapping[str, Float64Array]) -> list[tuple[float, frozenset[str]]]:
    """Pairs of check points nearer than ``NEAR_DISTANCE_M``, with their distance."""
    if len(names) < 2:
        return []
    places = np.array([xyz[name] for name in names])
    distance = np.linalg.norm(places[:, None] - places[None, :], axis=2)
    pairs = np.argwhere(np.triu(distance < NEAR_DISTANCE_M, k=1)).tolist()
    return [(float(distance[i, j]), frozenset((names[i], names[j]))) for i, j in pairs]


def _find_merged_pairs(members: Sequence[tuple[str, str]]) -> set[frozenset[str]]:
    """Pairs of check points that one defect holds sightings of."""
    of_defect: dict[str, set[str]] = {}
    for defect, target in members:
        of_defect.setdefault(defect, set()).add(target)
    return {frozenset((a, b)) for targets in of_defect.values() for a in targets for b in targets if a < b}
