"""Sightings to defects: Algorithm 1 corrected, over all sightings at once.

The paper's Algorithm 1 walks through the detections and calls one new if it is far from *any* earlier defect; with two
defects on a wall every further sighting is far from one of them, so it becomes new again. A sighting is new only if it
is far from *all*. And as the result of a walk depends on its order, the closest pairs are joined first, whatever the
order of the rows.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from facadelake.register.gate import Candidates


def clusters_of(candidates: Candidates, photo: NDArray[np.int64], agreement: float) -> NDArray[np.int64]:
    """Cluster number (n,) of each sighting, numbered by first member.

    Pairs join from the nearest up. Two groups join only if they share no photograph (``photo`` (n,)) and at least
    ``agreement`` of the pairs between them lie in the gate, so that a chain of neighbours does not become one defect.
    """
    near: dict[int, set[int]] = defaultdict(set)
    for i, j in zip(candidates.first.tolist(), candidates.second.tolist(), strict=True):
        near[i].add(j)
        near[j].add(i)
    owner = list(range(len(photo)))
    members = {i: [i] for i in owner}
    photos = {i: {int(photo[i])} for i in owner}
    # Ties in distance are broken by the rows, which the caller has put in a fixed order.
    order = np.lexsort((candidates.second, candidates.first, candidates.distance))
    for i, j in zip(candidates.first[order].tolist(), candidates.second[order].tolist(), strict=True):
        small, large = sorted((owner[i], owner[j]), key=lambda group: (len(members[group]), group))
        if small == large or photos[small] & photos[large]:
            continue
        inside = sum(len(near[member].intersection(members[large])) for member in members[small])
        if inside < agreement * len(members[small]) * len(members[large]):
            continue
        for member in members[small]:
            owner[member] = large
        members[large] += members.pop(small)
        photos[large] |= photos.pop(small)
    first = {group: min(rows) for group, rows in members.items()}
    _, numbers = np.unique([first[group] for group in owner], return_inverse=True)
    return np.asarray(numbers, dtype=np.int64)
