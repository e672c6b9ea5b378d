"""A later campaign's tie points found again in the reference of the building, without GPS.

Tie points of both campaigns are compared by descriptor (3D to 3D), the similarity that most pairs share is searched,
and it must win clearly: a facade repeats, and one window to the side many windows still agree.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Array, RowIndices, UInt8Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity, estimate_similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.campaign.consistency import (
    compute_chi_square,
    compute_misfit,
    count_shared_cells,
    extend_agreement_by_bending,
    find_occupied_cells,
    remove_bending,
)
from facadelake.georeferencing.campaign.descriptor_matching import DescriptorPairs, match_descriptors
from facadelake.georeferencing.campaign.reference import MAX_POINTS, ReferencePoints, check_descriptor_count
from facadelake.georeferencing.campaign.similarity_search import SharedSimilarity, search_similarity
from facadelake.sfm import Reconstruction, compute_tie_point_covariance, describe_tie_point_views, estimate_pixel_sigma

logger = logging.getLogger(__name__)

# Above it, a descriptor's second choice is as good as its first; wrong pairs are left to the search.
_MAX_RATIO = 0.9
# What a free block bends by, beside the stretch and the doming that are taken out: 2 to 12 cm over 40 m.
_BENDING_M, _BENDING_SHARE = 0.05, 0.002
_TOLERANCE_SIGMAS = 3.5
# The same spot under other light or after rain is found to about half a pixel, in all photographs alike.
_RECOGNITION_PX = 0.5
# Chance brings 4 to 10 pairs together. Eight square metres of facade are a placement, one window is none.
_MIN_AGREEING, _MIN_CELLS = 30, 8
_MAX_RUNNER_UP_SHARE = 0.4
_MAX_MISFIT = 2.0
_MIN_CELLS_SHARE = 0.5
# Chi-square of three coordinates that one right pair in a thousand exceeds.
_CHI_SQUARE_GATE = 16.3
# A descriptor does not survive a turn wider than this: such pairs agree by chance.
_MIN_DIRECTION_COSINE = 0.25


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceMatch:
    """Where a later campaign stands in the reference's frame, and the tie points that say so.

    Row k: tie point ``point[k]`` of the reconstruction is point ``reference[k]`` of the reference, at ``xyz_site_m[k]``
    within ``covariance_m2[k]``; ``residual_m`` (k, 3) is the reference minus ``site_from_sfm`` of the tie point.

    The covariance is for a prior on the tie point in the later campaign's adjustment: the reference point's own, and
    half a pixel for what the surface looks like on another day. The reference's common error is not in it, see
    ``ReferencePoints``.

    What it rests on: ``points_compared`` and ``reference_points`` count the tie points of the later campaign and the reference,
    ``pairs`` those that look alike, ``agreeing`` those of them that agree on this placement before the last, closer
    gate, ``runner_up`` those that agree on the next best, different one. ``compute_misfit`` is how many times farther apart the
    agreeing pairs are than their covariances say; in ``cells_agreeing`` of the ``cells`` (1 m cells) where both
    campaigns have tie points some agree.
    """

    site_from_sfm: Similarity
    point: RowIndices
    reference: RowIndices
    xyz_site_m: Float64Array
    covariance_m2: Float64Array
    residual_m: Float64Array
    points_compared: int
    reference_points: int
    pairs: int
    agreeing: int
    runner_up: int
    misfit: float
    cells_agreeing: int
    cells: int


def match_reference(
    reconstruction: Reconstruction,
    descriptors: UInt8Array,
    reference: ReferencePoints,
    *,
    origin: SiteOrigin,
    seed: int = 1,
) -> ReferenceMatch:
    """Find the reference's points among the tie points of a later campaign; ``origin`` is the site frame of the answer.

    GPS is not used, so that it can judge the answer. What the surface shows anew (repairs, cracks, shadows) finds no
    partner or disagrees with the rest.
    Raises GeoreferenceError where fewer than 30 points agree or they lie on one window's worth of wall, where a
    different placement has nearly as many for it, and where what agrees seems to be a surface that only looks alike.
    Facades of which every square metre repeats to the millimetre cannot be told apart: check the answer against GPS.
    """
    check_descriptor_count(reconstruction, descriptors)
    reference = reference.transform_to(origin)
    later = _select_tie_points(reconstruction)
    pairs = match_descriptors(descriptors[later.row], reference.descriptors, largest_ratio=_MAX_RATIO)
    source, target = later.xyz_sfm[pairs.a], reference.xyz_site_m[pairs.b]
    found, runner_up = _find_placement(source, target, _compute_tolerance(reference, pairs), seed)
    _refuse_too_few(found, target, runner_up, reference, f"{len(pairs)} of {len(later.row)} tie points look alike")
    assert found is not None
    return _build_match(later, reference, pairs, found, runner_up)


def _refuse_too_few(
    found: SharedSimilarity | None, target: Float64Array, runner_up: int, reference: ReferencePoints, alike: str
) -> None:
    agreeing = 0 if found is None else int(found.agrees.sum())
    places = 0 if found is None else len(find_occupied_cells(target[found.agrees]))
    if agreeing < _MIN_AGREEING or places < _MIN_CELLS:
        raise GeoreferenceError(
            f"the campaign cannot be found in the reference (campaign {reference.campaign_id} of "
            f"{reference.building_id}, {len(reference)} points): {alike}, and {agreeing} agree on one placement, in "
            f"{places} places of 1 m (at least {_MIN_AGREEING} in {_MIN_CELLS} are needed); is it the same "
            "building? Photograph from similar places as then, or place it by control points or the model"
        )
    if runner_up > _MAX_RUNNER_UP_SHARE * agreeing:
        raise GeoreferenceError(
            f"two placements in the reference (campaign {reference.campaign_id} of {reference.building_id}) compete: "
            f"{agreeing} points agree on the best, {runner_up} on a different one (limit {_MAX_RUNNER_UP_SHARE:.0%} of "
            "the best), as on a facade that repeats itself; photograph a corner or the ground with it, or give control "
            "points"
        )


def _refuse_look_alike(
    agreeing: int, far: float, places_agreeing: int, places: int, reference: ReferencePoints
) -> None:
    share = places_agreeing / max(places, 1)
    if far > _MAX_MISFIT or share < _MIN_CELLS_SHARE:
        raise GeoreferenceError(
            f"the campaign agrees with the reference (campaign {reference.campaign_id} of {reference.building_id}) in "
            f"{agreeing} points, but as a surface does that only looks alike: they lie {far:.1f} times as far apart as "
            f"they should (limit {_MAX_MISFIT:.1f}), and are in {places_agreeing} of the {places} places of 1 m "
            f"that both show ({share:.0%}, at least {_MIN_CELLS_SHARE:.0%}); does it show the part of the building "
            "that was photographed then? Photograph that part too, or place it by control points or the model"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _CampaignTiePoints:
    """Tie points (n) of the later campaign that can be compared: rows, places and covariances in sfm; ``direction``
    and ``gsd`` in sfm as in ``Seen``."""

    row: RowIndices
    xyz_sfm: Float64Array
    covariance_sfm: Float64Array
    direction: Float64Array
    gsd: Float64Array


def _select_tie_points(reconstruction: Reconstruction) -> _CampaignTiePoints:
    cameras = [PosedCamera(camera=p.camera, site_from_cam=p.sfm_from_cam) for p in reconstruction.photos]
    xyz = reconstruction.xyz_sfm
    covariance = compute_tie_point_covariance(
        reconstruction, cameras, xyz, sigma_px=estimate_pixel_sigma(reconstruction)
    )
    seen = describe_tie_point_views(reconstruction, cameras, xyz)
    usable = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)))
    row = np.sort(usable[np.argsort(-seen.photographs[usable], kind="stable")[:MAX_POINTS]])
    return _CampaignTiePoints(
        row=row,
        xyz_sfm=xyz[row],
        covariance_sfm=covariance[row],
        direction=seen.direction[row],
        gsd=seen.gsd[row],
    )


def _compute_tolerance(reference: ReferencePoints, pairs: DescriptorPairs) -> Float64Array:
    """How far (k,) a right pair may lie off after a similarity: both points' errors, and the bending of free blocks."""
    low, high = np.percentile(reference.xyz_site_m, [2, 98], axis=0)
    bending_m = _BENDING_M + _BENDING_SHARE * float(np.linalg.norm(high - low))
    own_m = np.sqrt(2 * np.linalg.eigvalsh(reference.covariance_m2[pairs.b])[:, 2])
    tolerance: Float64Array = np.hypot(bending_m, _TOLERANCE_SIGMAS * own_m)
    return tolerance


def _find_placement(
    source: Float64Array, target: Float64Array, tolerance: Float64Array, seed: int
) -> tuple[SharedSimilarity | None, int]:
    """The best placement of the ordered pairs, and how many agree on the best *different* one among the others."""
    if len(source) < _MIN_AGREEING:
        return None, 0
    best = search_similarity(source, target, tolerance, seed=seed)
    if best is None:
        return None, 0
    agrees = extend_agreement_by_bending(target, best.residual, best.agrees, tolerance)
    fit = estimate_similarity(source[agrees], target[agrees], 1.0 / tolerance[agrees] ** 2)
    best = SharedSimilarity(target_from_source=fit, agrees=agrees, residual=target - fit.apply(source))
    left, where = ~agrees, target[agrees]
    for attempt in range(1, 4):
        rival = search_similarity(source[left], target[left], tolerance[left], seed=seed + attempt)
        if rival is None:
            return best, 0
        there = rival.target_from_source.apply(best.target_from_source.invert().apply(where))
        if float(np.median(np.linalg.norm(there - where, axis=1))) > 3.0 * float(np.median(tolerance)):
            return best, int(rival.agrees.sum())
        left[np.flatnonzero(left)[rival.agrees]] = False  # the same placement, of a part that bends away
    return best, 0


def _build_match(
    later: _CampaignTiePoints,
    reference: ReferencePoints,
    pairs: DescriptorPairs,
    found: SharedSimilarity,
    runner_up: int,
) -> ReferenceMatch:
    """The agreeing pairs that also fit within the covariances, and the similarity fitted to them."""
    a, b = pairs.a[found.agrees], pairs.b[found.agrees]
    source, target = later.xyz_sfm[a], reference.xyz_site_m[b]
    site_from_sfm = found.target_from_source
    gsd_m = np.fmax(later.gsd[a] * site_from_sfm.scale, reference.gsd_m[b])
    known = reference.covariance_m2[b] + ((_RECOGNITION_PX * gsd_m) ** 2)[:, None, None] * np.eye(3)
    turned = site_from_sfm.scale * site_from_sfm.rotation
    both = known + turned @ later.covariance_sfm[a] @ turned.T
    squared = compute_chi_square(remove_bending(target, found.residual[found.agrees], both), both)
    looked = np.einsum("ki,ki->k", site_from_sfm.rotate(later.direction[a]), reference.direction_site[b])
    kept = (squared < _CHI_SQUARE_GATE) & (looked > _MIN_DIRECTION_COSINE)
    places_agreeing, places = count_shared_cells(site_from_sfm.apply(later.xyz_sfm), reference.xyz_site_m, target)
    far = compute_misfit(squared)
    logger.info(
        "reference %s: %d of %d pairs agree, %d on the next best; misfit %.1f, in %d of %d places",
        *(reference.campaign_id, len(a), len(pairs), runner_up, far, places_agreeing, places),
    )
    _refuse_look_alike(len(a), far, places_agreeing, places, reference)
    site_from_sfm = estimate_similarity(source[kept], target[kept], 1.0 / np.trace(both[kept], axis1=1, axis2=2))
    return ReferenceMatch(
        site_from_sfm=site_from_sfm,
        point=later.row[a[kept]],
        reference=b[kept],
        xyz_site_m=target[kept],
        covariance_m2=known[kept],
        residual_m=(target - site_from_sfm.apply(source))[kept],
        points_compared=len(later.row),
        reference_points=len(reference),
        pairs=len(pairs),
        agreeing=len(a),
        runner_up=runner_up,
        misfit=far,
        cells_agreeing=places_agreeing,
        cells=places,
    )
