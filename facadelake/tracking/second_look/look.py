"""Looks at the places of defects in the photographs of campaigns that did not detect them."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.building.surface import Surface, check_visibility, project_points
from facadelake.core.arrays import BoolArray, Float64Nx3, Float64x3, UInt8Image
from facadelake.core.camera import PosedCamera
from facadelake.core.progress import report_progress
from facadelake.detection.inference import read_photograph
from facadelake.registration import compute_tangents
from facadelake.tracking.second_look.alignment import Detail
from facadelake.tracking.second_look.comparison import (
    SURROUND_MIN_M,
    Comparison,
    PatchGrid,
    Place,
    compare_views,
    rectify_patch,
)
from facadelake.tracking.second_look.verdict import judge_comparison
from schemas.vocabulary import DefectClass, LookVerdict

_log = logging.getLogger(__name__)

_VIEWS = 3  # of each campaign: their median shows what is on the wall
_COARSER_MAX = 2.5  # a view of larger pixels, as a factor on the best one's, is left out
_INCIDENCE_MAX_DEG = 70.0
_HIDDEN_TOLERANCE_M = 0.3
_SURFACE_MAX_M = 0.5  # from the model's surface; beyond it the model has no wall at the place
_ALIGNED_WITHIN_M = 0.05
_BATCH = 48  # looks whose patches are in memory at a time
_PICTURE_SIDE_MIN, _JPEG_QUALITY, _GAP_PX = 160, 85, 4


@dataclass(frozen=True, kw_only=True, eq=False)
class CampaignViews:
    """Photographs of a campaign: poses in the building's site frame, and their folder."""

    posed: Mapping[str, PosedCamera]
    root: Path


@dataclass(frozen=True, kw_only=True, eq=False)
class LookRequest:
    """A look at the place of defect ``defect_id`` of ``seen_campaign`` in the photographs of ``campaign_id``.

    ``xyz_seen_m``, ``xyz_other_m`` (3,): the place in the frames of both campaigns.
    """

    seen_campaign: str
    defect_id: str
    defect_class: DefectClass
    campaign_id: str
    xyz_seen_m: Float64x3
    xyz_other_m: Float64x3
    normal_site: Float64x3
    width_m: float
    height_m: float

    @property
    def key(self) -> tuple[str, str, str]:
        """What identifies the look: campaign that detected the defect, the defect, campaign looked at."""
        return self.seen_campaign, self.defect_id, self.campaign_id

    def build_place(self, campaign_id: str) -> Place:
        """The place in the frame of one of the two campaigns."""
        return Place(
            xyz_site_m=self.xyz_seen_m if campaign_id == self.seen_campaign else self.xyz_other_m,
            normal_site=self.normal_site,
            width_m=self.width_m,
            height_m=self.height_m,
        )


@dataclass(frozen=True, kw_only=True)
class Look:
    """What a look says; ``key`` is that of its request.

    ``photo_ids``: best photograph, number of photographs, of the campaign that detected the defect and of the other.
    ``picture``: both patches at one scale as a JPEG, the earlier detected one on the left.
    """

    key: tuple[str, str, str]
    verdict: LookVerdict
    photo_ids: tuple[str | None, str | None]
    photo_counts: tuple[int, int]
    comparison: Comparison | None = None
    picture: bytes | None = None
    remark: str | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class _View:
    photo_id: str
    pixel_m: float
    whole: bool  # with the surroundings


def look_at_places(
    requests: Sequence[LookRequest], campaigns: Mapping[str, CampaignViews], surface: Surface
) -> list[Look]:
    """Look at places, in the order of the requests.

    Args:
        requests: the places, each with two campaigns.
        campaigns: the campaigns by id.
        surface: the building's surface, which may hide a place.
    """
    if not requests:
        return []
    views = _choose_views(requests, campaigns, surface)
    distance = surface.measure_distance(np.array([request.xyz_seen_m for request in requests]))
    looks: list[Look] = []
    with report_progress("Looking at places", len(requests)) as step:
        for first in range(0, len(requests), _BATCH):
            rows = range(first, min(first + _BATCH, len(requests)))
            grids = {row: grid for row in rows if (grid := _build_grid(requests[row], views[row])) is not None}
            patches = _read_patches(requests, campaigns, views, grids)
            for row in rows:
                looks.append(_look(requests[row], views[row], grids.get(row), patches.get(row), float(distance[row])))
                step.advance()
    return looks


_Views = tuple[list[_View], list[_View]]
_Patches = tuple[list[Detail] | None, list[Detail] | None]  # None: no file can be read


def _choose_views(
    requests: Sequence[LookRequest], campaigns: Mapping[str, CampaignViews], surface: Surface
) -> list[_Views]:
    """The photographs of both campaigns that show each place, those of the smallest pixels first."""
    found: list[_Views] = [([], []) for _ in requests]
    normals = np.array([request.normal_site for request in requests])
    for campaign_id, campaign in campaigns.items():
        for side in (0, 1):
            rows = [
                row
                for row, request in enumerate(requests)
                if (request.seen_campaign, request.campaign_id)[side] == campaign_id
            ]
            if not rows:
                continue
            centres = np.array([requests[row].build_place(campaign_id).xyz_site_m for row in rows])
            corners = np.stack(
                [
                    np.vstack([_list_corners(place, 0.0), _list_corners(place, SURROUND_MIN_M)])
                    for place in (requests[row].build_place(campaign_id) for row in rows)
                ]
            )
            for photo_id, posed in campaign.posed.items():
                seen = check_visibility(
                    posed,
                    surface,
                    centres,
                    normals[rows],
                    tolerance_m=_HIDDEN_TOLERANCE_M,
                    max_incidence_deg=_INCIDENCE_MAX_DEG,
                )
                near = np.flatnonzero(seen.visible)
                if len(near):
                    _, inside = project_points(posed, corners[near].reshape(-1, 3))
                    corners_inside = inside.reshape(len(near), -1)  # four of the place, four with its surroundings
                    whole: BoolArray = np.all(corners_inside[:, 4:], axis=1)
                    for k in np.flatnonzero(corners_inside[:, :4].all(axis=1)).tolist():
                        view = _View(photo_id=photo_id, pixel_m=float(seen.pixel_m[near[k]]), whole=bool(whole[k]))
                        found[rows[near[k]]][side].append(view)
    for both in found:
        for one in both:
            one.sort(key=lambda view: (not view.whole, view.pixel_m, view.photo_id))
    return found


def _list_corners(place: Place, margin_m: float) -> Float64Nx3:
    """Corners (4, 3) in site of a place's extents, with a margin."""
    across, upward = (axis[0] for axis in compute_tangents(place.normal_site[None]))
    signs = np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])
    half = np.array([place.width_m, place.height_m]) / 2 + margin_m
    corners: Float64Nx3 = place.xyz_site_m + (signs * half) @ np.stack([across, upward])
    return corners


def _build_grid(request: LookRequest, views: _Views) -> PatchGrid | None:
    """The grid that both campaigns resolve; None where one of them does not show the place."""
    if not views[0] or not views[1]:
        return None
    gsd_m = max(one[min(1, len(one) - 1)].pixel_m for one in views)
    return PatchGrid.build(request.build_place(request.seen_campaign), gsd_m)


def _read_patches(
    requests: Sequence[LookRequest],
    campaigns: Mapping[str, CampaignViews],
    views: Sequence[_Views],
    grids: Mapping[int, PatchGrid],
) -> dict[int, _Patches]:
    """Rectified patches of the best views by row, read photograph by photograph."""
    wanted: dict[tuple[str, str], list[tuple[int, int, int]]] = {}
    for row in grids:
        for side, campaign_id in enumerate((requests[row].seen_campaign, requests[row].campaign_id)):
            best = views[row][side]
            for place, view in enumerate(best[:_VIEWS]):
                if view.pixel_m <= _COARSER_MAX * min(one.pixel_m for one in best):
                    wanted.setdefault((campaign_id, view.photo_id), []).append((row, side, place))
    found: dict[tuple[int, int], dict[int, Detail]] = {}
    for (campaign_id, photo_id), targets in sorted(wanted.items()):
        campaign = campaigns[campaign_id]
        image = _read_grey(campaign.root / photo_id, campaign.posed[photo_id])
        if image is None:
            continue
        for row, side, place in targets:
            patch = rectify_patch(image, campaign.posed[photo_id], requests[row].build_place(campaign_id), grids[row])
            patches = found.setdefault((row, side), {})
            if patch is not None:
                patches[place] = patch
    in_order = {key: [patches[place] for place in sorted(patches)] for key, patches in found.items()}
    return {row: (in_order.get((row, 0)), in_order.get((row, 1))) for row in grids}


def _read_grey(path: Path, posed: PosedCamera) -> UInt8Image | None:
    """Grey values of a photograph as stored; None where it is not there, damaged or of another size."""
    image = read_photograph(path) if path.is_file() else None
    if image is None or image.shape[:2] != (posed.camera.height_px, posed.camera.width_px):
        _log.warning("%s cannot be looked at: it is missing, damaged, or not of the size of its pose", path)
        return None
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _look(
    request: LookRequest, views: _Views, grid: PatchGrid | None, patches: _Patches | None, distance_m: float
) -> Look:
    """The look at one place."""
    best = tuple(one[0].photo_id if one else None for one in views)
    counts = (len(views[0]), len(views[1]))

    def report(verdict: LookVerdict, remark: str | None = None) -> Look:
        return Look(key=request.key, verdict=verdict, photo_ids=(best[0], best[1]), photo_counts=counts, remark=remark)

    if distance_m > _SURFACE_MAX_M:
        return report(LookVerdict.NOT_IN_VIEW, f"the building's model has no surface within {_SURFACE_MAX_M} m")
    if not views[1]:
        return report(LookVerdict.NOT_IN_VIEW)
    if grid is None or patches is None:
        return report(LookVerdict.UNDECIDED, f"no photograph of {request.seen_campaign} shows the place as a whole")
    for campaign_id, side in zip((request.seen_campaign, request.campaign_id), patches, strict=True):
        if side is None:
            return report(LookVerdict.NO_PHOTOGRAPH, f"the photographs of {campaign_id} cannot be read")
        if not side:
            return report(
                LookVerdict.UNDECIDED, f"no photograph of {campaign_id} shows the place with its surroundings"
            )
    assert patches[0] and patches[1]
    found = compare_views(patches[0], patches[1], grid, _ALIGNED_WITHIN_M)
    return Look(
        key=request.key,
        verdict=judge_comparison(found, request.defect_class),
        photo_ids=(best[0], best[1]),
        photo_counts=counts,
        comparison=found,
        picture=_draw_pair(patches[0][0], patches[1][0]),
    )


def _draw_pair(seen: NDArray[np.float32], other: NDArray[np.float32]) -> bytes:
    """Both patches side by side, each stretched to its own grey values, as a JPEG."""
    factor = max(1, -(-_PICTURE_SIDE_MIN // max(min(seen.shape), 1)))
    both = []
    for patch in (seen, other):
        low, high = np.percentile(patch, [0.5, 99.5])
        grey = np.clip((patch - low) / max(high - low, 1.0) * 255, 0, 255).astype(np.uint8)
        both.append(cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC))
    gap = np.full((both[0].shape[0], _GAP_PX), 255, np.uint8)
    done, data = cv2.imencode(".jpg", np.hstack([both[0], gap, both[1]]), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    assert done
    return data.tobytes()
