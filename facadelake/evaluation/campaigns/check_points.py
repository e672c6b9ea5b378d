"""Check points against defects: missed, duplicated and false defects."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from facadelake.core.arrays import Float64x3

# The paper's Algorithm 1 merges detections nearer than this; it would merge neighbouring defects inside this distance.
NEAR_DISTANCE_M = 0.5


@dataclass(frozen=True, kw_only=True)
class CheckPointCounts:
    """Numbers of check points and of defects without one.

    ``total``: all check points; ``detected``: those that an accepted detection shows; ``missed``: those that no defect
    shows, of which ``lost`` were detected; ``duplicated``: those that more than one defect shows. ``false_defects``:
    defects most of whose observations show no check point. ``near_pairs``: pairs of registered check points less than
    0.5 m apart, of which ``near_apart`` have no defect with observations of both; ``nearest_apart_m``: the smallest
    distance of these.
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

    def convert_to_json(self) -> dict[str, float | int | None]:
        """The fields as keys."""
        return asdict(self)


def count_check_points(
    *,
    xyz_true_site_m: Mapping[str, Float64x3],
    detected_check_points: Iterable[str],
    check_point_by_defect: Sequence[str | None],
    members: Sequence[tuple[str, str]],
) -> CheckPointCounts:
    """Count missed, duplicated and false defects.

    Args:
        xyz_true_site_m: Position (3,) of each check point, m in site.
        detected_check_points: Check points that accepted detections show.
        check_point_by_defect: The check point of each defect; None: it shows none.
        members: Registered observations as (defect, check point).
    """
    defects_of_point = Counter(point for point in check_point_by_defect if point is not None)
    detected = set(detected_check_points)
    missed = [name for name in xyz_true_site_m if name not in defects_of_point]
    pairs = _find_near_pairs(sorted({point for _, point in members}), xyz_true_site_m)
    merged = _find_merged_pairs(members)
    apart = [distance for distance, pair in pairs if pair not in merged]
    return CheckPointCounts(
        total=len(xyz_true_site_m),
        detected=len(detected),
        missed=len(missed),
        lost=sum(name in detected for name in missed),
        duplicated=sum(count > 1 for count in defects_of_point.values()),
        false_defects=sum(point is None for point in check_point_by_defect),
        near_pairs=len(pairs),
        near_apart=len(apart),
        nearest_apart_m=min(apart, default=None),
    )


def _find_near_pairs(names: Sequence[str], xyz: Mapping[str, Float64x3]) -> list[tuple[float, frozenset[str]]]:
    """Pairs of check points nearer than ``NEAR_DISTANCE_M``, with their distance."""
    if len(names) < 2:
        return []
    positions = np.array([xyz[name] for name in names])
    distance = np.linalg.norm(positions[:, None] - positions[None, :], axis=2)
    pairs = np.argwhere(np.triu(distance < NEAR_DISTANCE_M, k=1)).tolist()
    return [(float(distance[i, j]), frozenset((names[i], names[j]))) for i, j in pairs]


def _find_merged_pairs(members: Sequence[tuple[str, str]]) -> set[frozenset[str]]:
    """Pairs of check points with observations in one defect."""
    points_of_defect: dict[str, set[str]] = {}
    for defect, point in members:
        points_of_defect.setdefault(defect, set()).add(point)
    return {frozenset((a, b)) for points in points_of_defect.values() for a in points for b in points if a < b}
