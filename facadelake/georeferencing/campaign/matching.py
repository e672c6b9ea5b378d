"""Recognition of an earlier campaign: tie points of a block matched with the reference of the building, without GPS.

Tie points of both campaigns are matched by descriptor (3D to 3D) and the similarity shared by most pairs is searched.
It must exceed every other clearly: a facade repeats, and one window to the side many windows still agree.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64N, Float64Nx3, Float64Nx3x3, RowIndices, UInt8Array
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
from facadelake.sfm import (
    Reconstruction,
    compute_tie_point_covariance,
    describe_tie_point_views,
    estimate_pixel_sigma,
)

logger = logging.getLogger(__name__)

# Above it, a descriptor's second neighbour is as near as its first; wrong pairs below it are left to the search.
_MAX_RATIO = 0.9
# Bending of a free block besides the stretch and the doming that are removed: 2 to 12 cm over 40 m.
_BENDING_M, _BENDING_SHARE = 0.05, 0.002
_TOLERANCE_SIGMAS = 3.5
# The same spot under other light or after rain is found to about half a pixel, in all photographs alike.
_RECOGNITION_PX = 0.5
# By chance 4 to 10 pairs agree. Eight square metres of facade are a placement, one window is none.
_MIN_AGREEING, _MIN_CELLS = 30, 8
_MAX_RUNNER_UP_SHARE = 0.4
_MAX_MISFIT = 2.0
_MIN_CELLS_SHARE = 0.5
# Chi-square of three coordinates that one right pair in a thousand exceeds.
_CHI_SQUARE_GATE = 16.3
# A descriptor does not survive a larger change of the viewing direction: such pairs agree by chance.
_MIN_DIRECTION_COSINE = 0.25


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceMatch:
    """The placement of a later campaign in the reference's frame, and the tie points shared with it.

    Row k: tie point ``point[k]`` of the reconstruction is point ``reference[k]`` of the reference, at ``xyz_site_m[k]``
    within ``covariance_m2[k]``; ``residual_m`` (k, 3) is the reference minus ``site_from_sfm`` of the tie point.

    The covariance is for a prior on the tie point in the later campaign's adjustment: the reference point's own, and
    half a pixel for the changed look of the surface. The reference's common error is not in it, see
    ``ReferencePoints``.

    ``points_compared`` and ``reference_points``: numbers of tie points of the later campaign and of the reference;
    ``pairs``: descriptor pairs; ``agreeing``: pairs that agree on the placement before the last, closer gate;
    ``runner_up``: pairs that agree on the next best, different one. ``misfit``: ratio of the agreeing pairs' residuals
    to their covariances. ``cells_agreeing`` of ``cells``: 1 m cells that both campaigns cover, with agreeing points.
    """

    site_from_sfm: Similarity
    point: RowIndices
    reference: RowIndices
    xyz_site_m: Float64Nx3
    covariance_m2: Float64Nx3x3
    residual_m: Float64Nx3
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
    """Match the tie points of a later campaign with the reference of an earlier one.

    GPS is not used, so that it can check the result. Changed surfaces (repairs, cracks, shadows) find no partner or
    disagree with the rest. Facades of which every square metre repeats to the millimetre cannot be distinguished: check
    the result against GPS.

    Args:
        reconstruction: the later campaign's block.
        descriptors: SIFT descriptors (m, 128) of its tie points.
        reference: the earlier campaign's reference.
        origin: origin of the site frame of the result.
        seed: seed of the search.

    Returns:
        the placement and the shared points.

    Raises:
        GeoreferenceError: fewer than 30 points agree, or they lie within one window; a different placement has nearly
            as many; or the agreement is that of a similar surface elsewhere.
    """
    check_descriptor_count(reconstruction, descriptors)
    reference = reference.transform_to(origin)
    later = _select_tie_points(reconstruction)
    pairs = match_descriptors(descriptors[later.row], reference.descriptors, max_ratio=_MAX_RATIO)
    source, target = later.xyz_sfm[pairs.a], reference.xyz_site_m[pairs.b]
    placement, runner_up = _find_placement(source, target, _compute_tolerance(reference, pairs), seed)
    similar = f"{len(pairs)} of {len(later.row)} tie points have a similar descriptor"
    _refuse_too_few(placement, target, runner_up, reference, similar)
    assert placement is not None
    return _build_match(later, reference, pairs, placement, runner_up)


def _refuse_too_few(
    placement: SharedSimilarity | None, target: Float64Nx3, runner_up: int, reference: ReferencePoints, similar: str
) -> None:
    """Raise GeoreferenceError where too few pairs agree, or a different placement has nearly as many."""
    agreeing = 0 if placement is None else int(placement.agrees.sum())
    cells = 0 if placement is None else len(find_occupied_cells(target[placement.agrees]))
    name = f"campaign {reference.campaign_id} of {reference.building_id}"
    if agreeing < _MIN_AGREEING or cells < _MIN_CELLS:
        raise GeoreferenceError(
            f"the campaign does not match the reference ({name}, {len(reference)} points): {similar}, and {agreeing} "
            f"agree on one placement, in {cells} cells of 1 m (at least {_MIN_AGREEING} in {_MIN_CELLS} are needed); "
            "is it the same building? Photograph from similar positions, or place it by control points or the model"
        )
    if runner_up > _MAX_RUNNER_UP_SHARE * agreeing:
        raise GeoreferenceError(
            f"two placements in the reference ({name}) compete: {agreeing} points agree on the best, {runner_up} on a "
            f"different one (limit {_MAX_RUNNER_UP_SHARE:.0%} of the best), as on a facade that repeats; photograph a "
            "corner or the ground too, or give control points"
        )


def _refuse_look_alike(
    agreeing: int, misfit: float, cells_agreeing: int, cells: int, reference: ReferencePoints
) -> None:
    """Raise GeoreferenceError where the agreement is that of a similar surface elsewhere."""
    share = cells_agreeing / max(cells, 1)
    if misfit > _MAX_MISFIT or share < _MIN_CELLS_SHARE:
        raise GeoreferenceError(
            f"the campaign matches the reference (campaign {reference.campaign_id} of {reference.building_id}) in "
            f"{agreeing} points, but on a different surface that looks alike: residuals are {misfit:.1f} times their "
            f"sigmas (limit {_MAX_MISFIT:.1f}), and points agree in {cells_agreeing} of the {cells} cells of 1 m that "
            f"both campaigns cover ({share:.0%}, at least {_MIN_CELLS_SHARE:.0%}); does it show the part of the "
            "building that was photographed then? Photograph that part too, or place it by control points or the model"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _CampaignTiePoints:
    """Tie points (n) of the later campaign that can be matched: ``row`` in the reconstruction, coordinates and
    covariance in sfm; ``direction`` and ``gsd`` in sfm as in ``TiePointViews``."""

    row: RowIndices
    xyz_sfm: Float64Nx3
    covariance_sfm: Float64Nx3x3
    direction: Float64Nx3
    gsd: Float64N


def _select_tie_points(reconstruction: Reconstruction) -> _CampaignTiePoints:
    """The tie points with a covariance, those in most photographs first where there are too many."""
    cameras = [PosedCamera(camera=p.camera, site_from_cam=p.sfm_from_cam) for p in reconstruction.photos]
    xyz = reconstruction.xyz_sfm
    covariance = compute_tie_point_covariance(
        reconstruction, cameras, xyz, sigma_px=estimate_pixel_sigma(reconstruction)
    )
    views = describe_tie_point_views(reconstruction, cameras, xyz)
    usable = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)))
    row = np.sort(usable[np.argsort(-views.photographs[usable], kind="stable")[:MAX_POINTS]])
    return _CampaignTiePoints(
        row=row,
        xyz_sfm=xyz[row],
        covariance_sfm=covariance[row],
        direction=views.direction[row],
        gsd=views.gsd[row],
    )


def _compute_tolerance(reference: ReferencePoints, pairs: DescriptorPairs) -> Float64N:
    """Tolerance (k,) of a right pair after a similarity: both points' errors, and the bending of free blocks."""
    low, high = np.percentile(reference.xyz_site_m, [2, 98], axis=0)
    bending_m = _BENDING_M + _BENDING_SHARE * float(np.linalg.norm(high - low))
    sigma_m = np.sqrt(2 * np.linalg.eigvalsh(reference.covariance_m2[pairs.b])[:, 2])
    tolerance: Float64N = np.hypot(bending_m, _TOLERANCE_SIGMAS * sigma_m)
    return tolerance


def _find_placement(
    source: Float64Nx3, target: Float64Nx3, tolerance: Float64N, seed: int
) -> tuple[SharedSimilarity | None, int]:
    """The best placement of the ordered pairs, and the number of others that agree on the best *different* one."""
    if len(source) < _MIN_AGREEING:
        return None, 0
    best = search_similarity(source, target, tolerance, seed=seed)
    if best is None:
        return None, 0
    agrees = extend_agreement_by_bending(target, best.residual, best.agrees, tolerance)
    fit = estimate_similarity(source[agrees], target[agrees], 1.0 / tolerance[agrees] ** 2)
    best = SharedSimilarity(target_from_source=fit, agrees=agrees, residual=target - fit.apply(source))
    others, agreeing = ~agrees, target[agrees]
    for attempt in range(1, 4):
        rival = search_similarity(source[others], target[others], tolerance[others], seed=seed + attempt)
        if rival is None:
            return best, 0
        moved = rival.target_from_source.apply(best.target_from_source.invert().apply(agreeing))
        if float(np.median(np.linalg.norm(moved - agreeing, axis=1))) > 3.0 * float(np.median(tolerance)):
            return best, int(rival.agrees.sum())
        others[np.flatnonzero(others)[rival.agrees]] = False  # the same placement, of a part that bends away
    return best, 0


def _build_match(
    later: _CampaignTiePoints,
    reference: ReferencePoints,
    pairs: DescriptorPairs,
    placement: SharedSimilarity,
    runner_up: int,
) -> ReferenceMatch:
    """The agreeing pairs that also fit within the covariances, and the similarity fitted to them."""
    a, b = pairs.a[placement.agrees], pairs.b[placement.agrees]
    source, target = later.xyz_sfm[a], reference.xyz_site_m[b]
    site_from_sfm = placement.target_from_source
    gsd_m = np.fmax(later.gsd[a] * site_from_sfm.scale, reference.gsd_m[b])
    prior = reference.covariance_m2[b] + ((_RECOGNITION_PX * gsd_m) ** 2)[:, None, None] * np.eye(3)
    jacobian = site_from_sfm.scale * site_from_sfm.rotation
    joint = prior + jacobian @ later.covariance_sfm[a] @ jacobian.T
    squared = compute_chi_square(remove_bending(target, placement.residual[placement.agrees], joint), joint)
    cosine = np.einsum("ki,ki->k", site_from_sfm.rotate(later.direction[a]), reference.direction_site[b])
    kept = (squared < _CHI_SQUARE_GATE) & (cosine > _MIN_DIRECTION_COSINE)
    cells_agreeing, cells = count_shared_cells(site_from_sfm.apply(later.xyz_sfm), reference.xyz_site_m, target)
    misfit = compute_misfit(squared)
    logger.info(
        "reference %s: %d of %d pairs agree, %d on the next best; misfit %.1f, in %d of %d cells",
        *(reference.campaign_id, len(a), len(pairs), runner_up, misfit, cells_agreeing, cells),
    )
    _refuse_look_alike(len(a), misfit, cells_agreeing, cells, reference)
    site_from_sfm = estimate_similarity(source[kept], target[kept], 1.0 / np.trace(joint[kept], axis1=1, axis2=2))
    return ReferenceMatch(
        site_from_sfm=site_from_sfm,
        point=later.row[a[kept]],
        reference=b[kept],
        xyz_site_m=target[kept],
        covariance_m2=prior[kept],
        residual_m=(target - site_from_sfm.apply(source))[kept],
        points_compared=len(later.row),
        reference_points=len(reference),
        pairs=len(pairs),
        agreeing=len(a),
        runner_up=runner_up,
        misfit=misfit,
        cells_agreeing=cells_agreeing,
        cells=cells,
    )
