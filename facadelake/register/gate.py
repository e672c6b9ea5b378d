"""Which two sightings may be of one defect: normalised distances between sightings of a class.

The paper's Algorithm 1 takes a fixed 0.5 m an axis (0.71 m), which merges neighbouring cracks. Here the gate follows
from the patches' extents, from what is left of the poses, and from the building's relief: a real surface that stands
off the model's shifts each sighting along its own ray, so two sightings of one place part in a known direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from facadelake.frames import Array
from facadelake.register.patch import tangents_of
from facadelake.register.settings import MergeSettings

_GRAZING_COSINE = 0.15  # a ray flatter than this says nothing more of relief


@dataclass(frozen=True, kw_only=True, eq=False)
class Sightings:
    """Registered observations as arrays, in a fixed order (n rows).

    ``ray_site`` (n, 3) is the unit direction from camera to surface; ``photo`` and ``defect_class`` are codes.
    """

    xyz_site_m: Array
    normal_site: Array
    ray_site: Array
    width_m: Array
    height_m: Array
    photo: NDArray[np.int64]
    defect_class: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.photo)


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidates:
    """Pairs of sightings inside the gate: ``first`` < ``second`` (k,) rows, ``distance`` (k,) in sigmas."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    distance: Array


def candidates_of(sightings: Sightings, settings: MergeSettings) -> Candidates:
    """Every pair of one class, of two photographs, inside the gate; by a spatial index, nearly linear in n."""
    pairs = _near_pairs(sightings, settings)
    distance = normalised_distance(sightings, pairs, settings)
    inside = distance <= settings.gate_sigma
    return Candidates(first=pairs[inside, 0], second=pairs[inside, 1], distance=distance[inside])


def normalised_distance(sightings: Sightings, pairs: NDArray[np.int64], settings: MergeSettings) -> Array:
    """Distance of each pair (k, 2) in sigmas (k,): Mahalanobis, with the covariance of the two sightings' difference.

    Each sighting varies by ``size_share`` of its extents along the surface and by ``floor_m`` in every direction. A
    surface that stands b (3,) off the model moves it by ``(normal . b) / (normal . ray) * ray``; both see the same b,
    of ``stand_off_m`` in each direction, so their difference varies by the difference of those two shifts alone.
    """
    i, j = pairs[:, 0], pairs[:, 1]
    shift = sightings.ray_site[:, :, None] * sightings.normal_site[:, None, :] / _facing(sightings)[:, None, None]
    apart = shift[i] - shift[j]
    covariance = _placing(sightings, settings)
    total = covariance[i] + covariance[j] + settings.stand_off_m**2 * apart @ apart.transpose(0, 2, 1)
    difference = sightings.xyz_site_m[i] - sightings.xyz_site_m[j]
    solved = np.linalg.solve(total, difference[:, :, None])[:, :, 0]
    distance: Array = np.sqrt(np.maximum((difference * solved).sum(axis=1), 0.0))
    return distance


def _placing(sightings: Sightings, settings: MergeSettings) -> Array:
    """Covariance (n, 3, 3) in m2 of each sighting's position for itself."""
    across, upward = tangents_of(sightings.normal_site)
    wide = (settings.size_share * sightings.width_m)[:, None] * across
    high = (settings.size_share * sightings.height_m)[:, None] * upward
    spread: Array = (
        wide[:, :, None] * wide[:, None, :]
        + high[:, :, None] * high[:, None, :]
        + settings.floor_m**2 * np.eye(3)[None]
    )
    return spread


def _facing(sightings: Sightings) -> Array:
    """Cosine between ray and normal, kept off zero and negative (normals face the camera)."""
    cosine: Array = np.minimum((sightings.ray_site * sightings.normal_site).sum(axis=1), -_GRAZING_COSINE)
    return cosine


def _near_pairs(sightings: Sightings, settings: MergeSettings) -> NDArray[np.int64]:
    """Pairs (k, 2) of one class and two photographs, no further apart than the ceiling or half their extents."""
    reach = np.hypot(sightings.width_m, sightings.height_m) / 2
    found = []
    for code in np.unique(sightings.defect_class):
        rows = np.flatnonzero(sightings.defect_class == code)
        tree = cKDTree(sightings.xyz_site_m[rows])
        near = tree.query_pairs(settings.reach_m, output_type="ndarray")
        found.append(np.sort(rows[near], axis=1))
        # A defect larger than the ceiling may be cut differently by each photograph: those few look further.
        for row in rows[2 * reach[rows] > settings.reach_m]:
            others = rows[tree.query_ball_point(sightings.xyz_site_m[row], 2 * reach[row])]
            others = others[others != row]
            gap = np.linalg.norm(sightings.xyz_site_m[others] - sightings.xyz_site_m[row], axis=1)
            others = others[(gap > settings.reach_m) & (gap <= reach[row] + reach[others])]
            found.append(np.sort(np.column_stack([np.full(len(others), row), others]), axis=1))
    pairs = np.unique(np.vstack([np.zeros((0, 2), dtype=np.int64), *found]), axis=0)
    apart: NDArray[np.int64] = pairs[sightings.photo[pairs[:, 0]] != sightings.photo[pairs[:, 1]]]
    return apart
