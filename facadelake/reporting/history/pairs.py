"""Pictures of a place in two campaigns at one scale: before, after, and their difference."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facadelake.building.surface import Surface, check_visibility, project_points
from facadelake.core.arrays import Float64Nx2, Float64Nx3, Float64x3, UInt8Image
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.frames import axes_from_normal
from facadelake.core.progress import track
from facadelake.reporting.cards.crops import format_file_label
from facadelake.reporting.cards.patch_view import PatchView, choose_patch_side_m, rectify_patch
from facadelake.reporting.drawing.photograph import read_photograph
from facadelake.reporting.elevations.marks import DefectMark
from facadelake.reporting.history.alignment import apply_alignment, find_alignment, render_difference

log = logging.getLogger(__name__)

_JPEG_QUALITY = 84
_CELLS_MIN = 140
_TRIES = 3  # photographs of a campaign that are tried for a place
_HELD = 4  # decoded photographs in memory
_INCIDENCE_MAX_DEG = 75.0
_TOLERANCE_M = 0.2
_CUT_PENALTY, _PREFERENCE = 4.0, 0.7  # factors on the size of a pixel: of a picture that is cut off, of the detection's
_VISIBLE_MIN = 0.8  # share of a picture that a photograph must show
_REACH_M = 0.05  # what poses of two campaigns may leave between their pictures


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedPhotographs:
    """Photographs of a campaign: poses in site, and their folder."""

    campaign_id: str
    posed: Mapping[str, PosedCamera]
    root: Path


@dataclass(frozen=True, kw_only=True, eq=False)
class PairRequest:
    """A place to be shown in an earlier and a later campaign.

    ``mark``: the defect there. ``photo_ids``: the photographs to be preferred. ``in_later``: the mark's position is in
    the frame of the later campaign, else of the earlier one; ``offset_m`` (3,): later minus earlier frame.
    """

    track_id: str
    mark: DefectMark
    photo_ids: tuple[str | None, str | None]
    in_later: bool
    offset_m: Float64x3

    def locate(self, later: bool) -> Float64x3:
        """The place in the frame of one of both campaigns."""
        if later == self.in_later:
            return self.mark.centre_site_m
        return self.mark.centre_site_m + (self.offset_m if later else -self.offset_m)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    """The pictures written for a track; None where there is none, and ``remarks`` say why.

    All are squares of ``side_m`` with cells of ``cell_m``. ``rings_m``: outline of the defect, m right and up of the
    centre. ``photo_ids``: the photographs shown.
    """

    before: Path | None
    after: Path | None
    difference: Path | None
    photo_ids: tuple[str | None, str | None]
    side_m: float
    cell_m: float
    rings_m: tuple[Float64Nx2, ...]
    remarks: tuple[str, ...]


class _Photographs:
    """Photographs of a campaign, the latest decoded ones in memory."""

    def __init__(self, source: PosedPhotographs) -> None:
        self.source = source
        self.unreadable: dict[str, str] = {}
        self._held: OrderedDict[str, UInt8Image] = OrderedDict()

    def read(self, photo_id: str) -> UInt8Image | None:
        """Pixels (h, w, 3), RGB; None where the file is not there or cannot be read."""
        if photo_id in self.unreadable:
            return None
        if photo_id not in self._held:
            try:
                pixels = read_photograph(self.source.root / photo_id, self.source.posed[photo_id].camera)
            except InputDataError as error:
                log.warning("photograph not used for a comparison: %s", error)
                self.unreadable[photo_id] = str(error)
                return None
            self._held[photo_id] = pixels
            while len(self._held) > _HELD:
                self._held.popitem(last=False)
        self._held.move_to_end(photo_id)
        return self._held[photo_id]


def write_pairs(
    requests: Sequence[PairRequest],
    earlier: PosedPhotographs,
    later: PosedPhotographs,
    surface: Surface,
    folder: Path,
    cells_max: int = 400,
) -> dict[str, Pair]:
    """Write the pictures of places in two campaigns into ``folder``.

    Args:
        requests: the places.
        earlier: photographs of the earlier campaign.
        later: photographs of the later campaign.
        surface: the building's surface.
        folder: folder to write into; created.
        cells_max: largest width of a picture, in cells.

    Returns:
        The pairs by track.
    """
    folder.mkdir(parents=True, exist_ok=True)
    sides = (_Photographs(earlier), _Photographs(later))
    views = [_rank_photographs(requests, source, surface, later=k == 1) for k, source in enumerate((earlier, later))]
    # Neighbours in this order are in the same photographs, so that few are decoded twice.
    order = sorted(range(len(requests)), key=lambda row: [[one.photo_id for one in side[row][:1]] for side in views])
    pairs: dict[str, Pair] = {}
    for row in track(order, label="Drawing before and after"):
        pairs[requests[row].track_id] = _write_pair(
            requests[row], sides, (views[0][row], views[1][row]), surface, folder, cells_max
        )
    return pairs


@dataclass(frozen=True, kw_only=True)
class _RankedView:
    """A photograph that shows a place: size of a pixel there, share of the picture's square inside it."""

    photo_id: str
    pixel_m: float
    inside: float
    preferred: bool

    @property
    def badness(self) -> tuple[float, str]:
        """The order of photographs: fine pixels, the whole square in view, and the photograph with the detection."""
        return self.pixel_m * (1 + _CUT_PENALTY * (1 - self.inside)) * (
            _PREFERENCE if self.preferred else 1.0
        ), self.photo_id


_Ranked = list[_RankedView]


def _rank_photographs(
    requests: Sequence[PairRequest], source: PosedPhotographs, surface: Surface, *, later: bool
) -> list[_Ranked]:
    """Photographs that show each place, the best first."""
    found: list[_Ranked] = [[] for _ in requests]
    if not requests:
        return found
    normals = np.array([request.mark.normal_site for request in requests])
    centres = np.array([request.locate(later) for request in requests])
    squares = [_list_square_points(request.mark) for request in requests]
    for photo_id, posed in source.posed.items():
        seen = check_visibility(
            posed, surface, centres, normals, tolerance_m=_TOLERANCE_M, max_incidence_deg=_INCIDENCE_MAX_DEG
        )
        for row in np.flatnonzero(seen.visible | seen.in_view).tolist():
            request = requests[row]
            preferred = photo_id == request.photo_ids[int(later)]
            if preferred or seen.visible[row]:
                inside = float(project_points(posed, squares[row] + centres[row])[1].mean())
                pixel_m = float(seen.pixel_m[row]) if np.isfinite(seen.pixel_m[row]) else 1.0
                found[row].append(_RankedView(photo_id=photo_id, pixel_m=pixel_m, inside=inside, preferred=preferred))
    for ranked in found:
        ranked.sort(key=lambda view: view.badness)
    return found


def _write_pair(
    request: PairRequest,
    sides: tuple[_Photographs, _Photographs],
    views: tuple[_Ranked, _Ranked],
    surface: Surface,
    folder: Path,
    cells_max: int,
) -> Pair:
    """Write the pictures of one place.

    Args:
        request: the place.
        sides: photographs of both campaigns.
        views: the photographs of each that show the place.
        surface: the building's surface.
        folder: folder to write into.
        cells_max: largest width of a picture, in cells.
    """
    side_m = choose_patch_side_m(request.mark)
    coarser_m = max((ranked[0].pixel_m for ranked in views if ranked), default=side_m / cells_max)
    cells = int(np.clip(np.ceil(side_m / coarser_m), _CELLS_MIN, cells_max))
    shown: list[tuple[str, PatchView] | None] = []
    remarks: list[str] = []
    for later, (photographs, ranked) in enumerate(zip(sides, views, strict=True)):
        view = _rectify(request, photographs, ranked, surface, cells, later=later == 1)
        shown.append(view)
        if view is None:
            remarks.append(_explain_absence(photographs, ranked))
    name = format_file_label(request.track_id)
    pictures = [None if one is None else one[1].picture for one in shown]
    difference: UInt8Image | None = None
    if shown[0] is not None and shown[1] is not None:
        first, second = shown[0][1], shown[1][1]
        warp = find_alignment(first, second, _REACH_M / first.cell_m)
        if warp is None:
            remarks.append(
                "the two pictures do not resemble each other, so they are not aligned and have no difference"
            )
        else:
            aligned = apply_alignment(second, warp)
            pictures[1] = aligned.picture
            difference = render_difference(first, aligned)
    drawn = next((one[1] for one in shown if one is not None), None)
    paths = [
        None if picture is None else _write(picture, folder / f"{name}_{word}.jpg")
        for picture, word in zip([*pictures, difference], ("before", "after", "difference"), strict=True)
    ]
    return Pair(
        before=paths[0],
        after=paths[1],
        difference=paths[2],
        photo_ids=(shown[0][0] if shown[0] else None, shown[1][0] if shown[1] else None),
        side_m=side_m,
        cell_m=side_m / cells,
        rings_m=() if drawn is None else drawn.rings_m,
        remarks=tuple(remarks),
    )


def _rectify(
    request: PairRequest, photographs: _Photographs, ranked: _Ranked, surface: Surface, cells: int, *, later: bool
) -> tuple[str, PatchView] | None:
    """The best photograph that can be read, rectified; None where there is none."""
    shift = request.locate(later) - request.mark.centre_site_m
    mark = _move_mark(request.mark, shift)
    best: tuple[str, PatchView] | None = None
    tried = 0
    for one in ranked:
        pixels = photographs.read(one.photo_id)
        if pixels is None:
            continue
        view = rectify_patch(mark, photographs.source.posed[one.photo_id], pixels, surface, cells, one.pixel_m)
        if best is None or view.visible.mean() > best[1].visible.mean():
            best = one.photo_id, view
        tried += 1
        if view.visible.mean() >= _VISIBLE_MIN or tried == _TRIES:
            break
    return best if best is not None and best[1].visible.any() else None


def _list_square_points(mark: DefectMark) -> Float64Nx3:
    """Points (9, 3) of the picture's square around a place, relative to its centre."""
    across, upward = axes_from_normal(mark.normal_site)[:2]
    steps = np.array([(x, y) for x in (-0.5, 0.0, 0.5) for y in (-0.5, 0.0, 0.5)]) * choose_patch_side_m(mark)
    points: Float64Nx3 = steps @ np.stack([across, upward])
    return points


def _explain_absence(photographs: _Photographs, ranked: _Ranked) -> str:
    campaign = photographs.source.campaign_id
    if not ranked:
        return f"no photograph of {campaign} shows the place"
    if not photographs.source.root.is_dir():
        return f"no picture of {campaign}: the folder of its photographs, {photographs.source.root}, is not there"
    missing = [one.photo_id for one in ranked if one.photo_id in photographs.unreadable]
    if missing:
        return (
            f"no picture of {campaign}: the photographs that show the place are not there or cannot be read "
            f"({', '.join(missing[:3])}{', ...' if len(missing) > 3 else ''} in {photographs.source.root})"
        )
    return f"what the photographs of {campaign} show of the place is hidden"


def _move_mark(mark: DefectMark, shift_m: Float64x3) -> DefectMark:
    return DefectMark(
        **{
            **mark.__dict__,
            "centre_site_m": mark.centre_site_m + shift_m,
            "outlines_site_m": tuple(ring + shift_m for ring in mark.outlines_site_m),
        }
    )


def _write(picture: UInt8Image, path: Path) -> Path:
    if not cv2.imwrite(str(path), picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]):
        raise InputDataError(f"picture {path} cannot be written; check free disk space and the folder's rights")
    return path
