"""Elevations with the findings of a comparison: photographs of the later campaign below, marks in SVG above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import cv2
import numpy as np

from facadelake.building import BuildingModel
from facadelake.building.surface import Surface
from facadelake.core.arrays import Float64Nx2
from facadelake.core.errors import InputDataError
from facadelake.reporting.drawing.labels import place_labels
from facadelake.reporting.elevations.elevation import render_background
from facadelake.reporting.elevations.facades import Facade, find_facades
from facadelake.reporting.elevations.marks import DefectMark, assign_marks
from facadelake.reporting.elevations.rectification import rectify_elevations
from facadelake.reporting.elevations.relief import choose_cell_size_m, render_relief
from facadelake.reporting.elevations.storeys import StoreyBase, find_storey_bases
from facadelake.reporting.history.findings import COUNTED_ONLY, Finding
from facadelake.reporting.history.pairs import PosedPhotographs
from facadelake.reporting.history.symbols import render_mark
from facadelake.reporting.html import Html, link_file
from facadelake.reporting.inspection import PictureSettings

_WIDTH_MAX_PX, _JPEG_QUALITY = 2000, 82
_PAGE_PX = 1180.0  # width of the page, at which marks and labels have their size
_FONT_PX, _MARK_SCALE = 12.0, 0.8
_MARGIN_PX = 100.0  # beside the picture, for the names of storeys
_ENLARGED_MAX, _NARROWEST_PX, _TALLEST_PX = 1.5, 420.0, 820.0  # small facades are not shown as large as the page


@dataclass(frozen=True, kw_only=True, eq=False)
class ElevationPicture:
    """The picture of a facade, of ``px_per_m``, and the marks on it."""

    facade: Facade
    path: Path
    width_px: int
    height_px: int
    px_per_m: float
    marks: tuple[DefectMark, ...]
    storeys: tuple[StoreyBase, ...]

    def locate(self, xyz_site_m: Float64Nx2) -> Float64Nx2:
        """Pixels (n, 2) in the picture of points (n, 3) of site."""
        uv = self.facade.uvw_from_site(xyz_site_m)[:, :2]
        px: Float64Nx2 = (uv - (self.facade.u_min_m, self.facade.v_max_m)) * (self.px_per_m, -self.px_per_m)
        return px


def draw_elevation_pictures(
    building: BuildingModel,
    surface: Surface,
    photographs: PosedPhotographs,
    marks: Sequence[DefectMark],
    folder: Path,
    settings: PictureSettings,
) -> list[ElevationPicture]:
    """Write ``elevation_<facade>.jpg`` of each facade that has a mark.

    Args:
        building: the building model.
        surface: its surface.
        photographs: photographs that colour the facades.
        marks: the defects.
        folder: folder to write into; created.
        settings: resolution of the pictures.

    Returns:
        The pictures, the facade with most marks first.
    """
    folder.mkdir(parents=True, exist_ok=True)
    places: dict[str, list[np.ndarray]] = {}
    for mark in marks:
        places.setdefault(mark.facade, []).append(mark.centre_site_m)
    positions = {name: np.array(points) for name, points in places.items()}
    facades = find_facades(building, surface, photographs.posed, positions, settings)
    assigned, _ = assign_marks(facades, marks)
    kept = [(facade, own) for facade, own in zip(facades, assigned, strict=True) if own]
    reliefs = [render_relief(facade, surface, choose_cell_size_m(facade, settings)) for facade, _ in kept]
    paths = {photo_id: photographs.root / photo_id for photo_id in photographs.posed}
    storeys = tuple(find_storey_bases(building))
    pictures = []
    rectified_all = rectify_elevations(reliefs, surface, photographs.posed, paths, settings)
    for rectified, (facade, own) in zip(rectified_all, kept, strict=True):
        background = render_background(rectified, building)
        scale = min(1.0, _WIDTH_MAX_PX / background.shape[1])
        size = (max(1, round(background.shape[1] * scale)), max(1, round(background.shape[0] * scale)))
        small = cv2.resize(background, size, interpolation=cv2.INTER_AREA)
        path = folder / f"elevation_{facade.name}.jpg"
        if not cv2.imwrite(str(path), small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]):
            raise InputDataError(f"picture {path} cannot be written; check free disk space and the folder's rights")
        pictures.append(
            ElevationPicture(
                facade=facade,
                path=path,
                width_px=size[0],
                height_px=size[1],
                px_per_m=size[0] / (background.shape[1] * rectified.relief.cell_m),
                marks=tuple(own),
                storeys=storeys,
            )
        )
    return sorted(pictures, key=lambda picture: (-len(picture.marks), picture.facade.name))


def render_elevation(
    picture: ElevationPicture, findings: Mapping[str, Finding], linked: Mapping[str, str], folder: Path
) -> Html:
    """The picture with its marks as a figure.

    Args:
        picture: the elevation; the marks' ``defect_id`` are ids of tracks.
        findings: the finding of each track.
        linked: anchors on the page by track; others have no link.
        folder: folder of the page.
    """
    widest_px = min(_PAGE_PX - _MARGIN_PX, _TALLEST_PX * picture.width_px / picture.height_px)
    shown_px = min(widest_px, max(_ENLARGED_MAX * picture.width_px, _NARROWEST_PX))
    unit = picture.width_px / shown_px  # px of the picture for one of the page
    shown = sorted(picture.marks, key=lambda mark: list(Finding).index(findings[mark.defect_id]), reverse=True)
    lines = [_render_storey(picture, storey, unit) for storey in picture.storeys]
    lines += [_render_outline(picture, mark, findings[mark.defect_id], unit) for mark in shown]
    centres = {mark.defect_id: picture.locate(mark.centre_site_m[None])[0] for mark in shown}
    for mark in shown:
        lines.append(_render_symbol(mark, findings[mark.defect_id], centres[mark.defect_id], linked, unit))
    lines += _render_labels(picture, shown, findings, centres, linked, unit)
    listed = sum(findings[mark.defect_id] not in COUNTED_ONLY for mark in shown)
    title = f"{picture.facade.title}: {len(shown)} defects, of which {listed} are listed"
    widest = f"{shown_px + _MARGIN_PX:.0f}px"
    box = f"0 0 {picture.width_px + _MARGIN_PX * unit:.0f} {picture.height_px + 34 * unit:.0f}"
    image = f'<image href="{link_file(picture.path, folder)}" width="{picture.width_px}" height="{picture.height_px}"/>'
    return Html(
        f'<figure class="elevation"><svg viewBox="{box}" style="max-width:{widest};--widest:{widest}" role="img" '
        f'aria-label="{escape(title, quote=True)}">{image}'
        + "".join(lines)
        + _render_scale_bar(picture, unit)
        + f"</svg><figcaption>{escape(title)}. Photographs of the later campaign; view from outside. "
        "Numbers are those of the tracks; unchanged defects have no number.</figcaption></figure>"
    )


def _render_storey(picture: ElevationPicture, storey: StoreyBase, unit: float) -> str:
    y = (picture.facade.v_max_m - storey.z_site_m) * picture.px_per_m
    if not 0 <= y <= picture.height_px:
        return ""
    x, size = picture.width_px + 5 * unit, 0.85 * _FONT_PX * unit
    return (
        f'<path class="storey" d="M0 {y:.1f}H{picture.width_px}" stroke-width="{unit:.2f}"/>'
        f'<text class="storey" y="{y:.1f}" font-size="{size:.1f}"><tspan x="{x:.1f}">{escape(storey.name)}</tspan>'
        f'<tspan x="{x:.1f}" dy="1.1em">{storey.z_site_m:+.1f} m</tspan></text>'
    )


def _render_outline(picture: ElevationPicture, mark: DefectMark, finding: Finding, unit: float) -> str:
    if finding in COUNTED_ONLY:
        return ""
    points = [" ".join(f"{x:.1f},{y:.1f}" for x, y in picture.locate(ring)) for ring in mark.outlines_site_m]
    return "".join(
        f'<polygon class="ring f-{finding.name.lower()}" points="{ring}" stroke-width="{1.4 * unit:.2f}"/>'
        for ring in points
    )


def _render_symbol(
    mark: DefectMark, finding: Finding, centre_px: np.ndarray, linked: Mapping[str, str], unit: float
) -> str:
    scale = _MARK_SCALE * unit * (0.7 if finding in COUNTED_ONLY else 1.0)
    drawn = (
        f'<g class="f-{finding.name.lower()}" transform="translate({centre_px[0]:.1f} {centre_px[1]:.1f}) '
        f'scale({scale:.3f})"><title>{escape(f"{mark.defect_id}: {finding}, {mark.defect_class}, {mark.severity}")}'
        f"</title>{render_mark(finding)}</g>"
    )
    anchor = linked.get(mark.defect_id)
    return f'<a href="#{escape(anchor, quote=True)}">{drawn}</a>' if anchor else drawn


def _render_labels(
    picture: ElevationPicture,
    marks: Sequence[DefectMark],
    findings: Mapping[str, Finding],
    centres: Mapping[str, np.ndarray],
    linked: Mapping[str, str],
    unit: float,
) -> list[str]:
    """Labels of the listed tracks beside their symbols.

    Args:
        picture: the elevation.
        marks: its marks.
        findings: the finding of each track.
        centres: pixels of the symbols.
        linked: anchors on the page by track.
        unit: pixels of the picture for one of the page.
    """
    own = [mark for mark in marks if findings[mark.defect_id] not in COUNTED_ONLY]
    if not own:
        return []
    at = np.array([centres[mark.defect_id] for mark in own])
    half = 9.0 * unit
    sizes = np.array([[(0.62 * len(mark.label) + 0.5) * _FONT_PX, 1.2 * _FONT_PX] for mark in own]) * unit
    placed = place_labels(
        np.hstack([at - half, at + half]), sizes, np.array([0.0, 0.0, picture.width_px, picture.height_px])
    )
    labels = []
    for mark, centre, size in zip(own, placed, sizes, strict=True):
        left, top = centre - size / 2
        text = (
            f'<g class="tag f-{findings[mark.defect_id].name.lower()}"><rect x="{left:.1f}" y="{top:.1f}" '
            f'width="{size[0]:.1f}" height="{size[1]:.1f}" rx="{3 * unit:.1f}" stroke-width="{unit:.2f}"/>'
            f'<text x="{centre[0]:.1f}" y="{centre[1] + 0.36 * _FONT_PX * unit:.1f}" text-anchor="middle" '
            f'font-size="{_FONT_PX * unit:.1f}">{escape(mark.label)}</text></g>'
        )
        anchor = linked.get(mark.defect_id)
        labels.append(f'<a href="#{escape(anchor, quote=True)}">{text}</a>' if anchor else text)
    return labels


def _render_scale_bar(picture: ElevationPicture, unit: float) -> str:
    width_m = picture.width_px / picture.px_per_m
    length_m = next((n for n in (50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5) if n <= width_m / 4), 0.2)
    left, y = 4 * unit, picture.height_px + 12 * unit
    return (
        f'<path class="scale" d="M{left:.1f} {y:.1f}h{length_m * picture.px_per_m:.1f}" '
        f'stroke-width="{4 * unit:.1f}"/><text class="storey" x="{left:.1f}" y="{y + 15 * unit:.1f}" '
        f'font-size="{0.9 * _FONT_PX * unit:.1f}">{length_m:g} m</text>'
    )
