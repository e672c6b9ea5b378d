"""Permanent ids: chains of defects take the ids that the same defects had before; new ones are minted once.

A chain has the id of the track with which it shares most sightings. A campaign that was committed anew has other
defects; then, and for tracks that had been withdrawn, the place and class of the track decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from facadelake.core.arrays import Float64N, Float64Nx3, RowIndices

Sighting = tuple[str, str, str]  # campaign_id, run_id, defect_id
_PLACE_WEIGHT = 0.4  # of a place beside one shared sighting: it decides where nothing is shared, never against
_CLASS_WEIGHT = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownTracks:
    """Tracks (n) of a building in the lake.

    ``number`` (n,): of their ids. ``xyz_site_m`` (n, 3): place. ``reach_m`` (n,): distance within which the same
    defect lies. ``defect_class`` (n,). ``sightings``: rows of the tracks by sighting.
    """

    number: RowIndices
    xyz_site_m: Float64Nx3
    reach_m: Float64N
    defect_class: RowIndices
    sightings: Mapping[Sighting, int]


@dataclass(frozen=True, kw_only=True, eq=False)
class Chains:
    """Chains (m): first place ``xyz_site_m`` (m, 3) and class, and the ``sightings`` of each."""

    xyz_site_m: Float64Nx3
    defect_class: RowIndices
    sightings: Sequence[Sequence[Sighting]]


def assign_track_numbers(known: KnownTracks, chains: Chains) -> RowIndices:
    """Numbers (m,) of the chains' ids: those of known tracks where they are the same defect, else the next free ones.

    Numbers are minted in the order of the chains, after the largest that was ever used.
    """
    count = len(chains.sightings)
    number = np.full(count, -1)
    weight: dict[tuple[int, int], float] = {}
    for chain, sightings in enumerate(chains.sightings):
        for sighting in sightings:
            track = known.sightings.get(sighting)
            if track is not None:
                weight[track, chain] = weight.get((track, chain), 0.0) + 1.0
    for track, chain, closeness in _find_near(known, chains):
        kept = _CLASS_WEIGHT if known.defect_class[track] == chains.defect_class[chain] else 0.0
        weight[track, chain] = weight.get((track, chain), 0.0) + _PLACE_WEIGHT * closeness + kept
    for track, chain in _maximise_weight(weight):
        number[chain] = known.number[track]
    new = np.flatnonzero(number < 0)
    number[new] = known.number.max(initial=0) + 1 + np.arange(len(new))
    return number


def format_track_id(building_id: str, number: int) -> str:
    """The id of a track: ``castle-0042``."""
    return f"{building_id}-{number:04d}"


def read_track_number(track_id: str) -> int:
    """The number in the id of a track."""
    return int(track_id.rpartition("-")[2])


def _find_near(known: KnownTracks, chains: Chains) -> list[tuple[int, int, float]]:
    """Tracks and chains at one place, with a closeness from 0 at the reach to 1."""
    if not len(known.number) or not len(chains.xyz_site_m):
        return []
    near = cKDTree(chains.xyz_site_m).query_ball_point(known.xyz_site_m, known.reach_m)
    pairs = [(track, chain) for track, found in enumerate(near) for chain in found]
    return [
        (t, c, 1 - float(np.linalg.norm(known.xyz_site_m[t] - chains.xyz_site_m[c]) / known.reach_m[t]))
        for t, c in pairs
        if known.reach_m[t] > 0
    ]


def _maximise_weight(weight: Mapping[tuple[int, int], float]) -> list[tuple[int, int]]:
    """Pairs of track and chain, each at most once, of largest total weight."""
    if not weight:
        return []
    tracks, chains = sorted({t for t, _ in weight}), sorted({c for _, c in weight})
    row, column = {t: k for k, t in enumerate(tracks)}, {c: k for k, c in enumerate(chains)}
    gain = np.zeros((len(tracks), len(chains)))
    for (track, chain), value in weight.items():
        gain[row[track], column[chain]] = value
    chosen = linear_sum_assignment(gain, maximize=True)
    return [(tracks[i], chains[j]) for i, j in zip(*map(np.ndarray.tolist, chosen), strict=True) if gain[i, j] > 0]
