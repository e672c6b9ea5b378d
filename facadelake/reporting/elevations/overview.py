"""Overview of a facade: its elevation at low resolution, with the location of one defect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from facadelake.building import BuildingModel
from facadelake.building.surface import Surface
from facadelake.core.arrays import UInt8Image
from facadelake.reporting.drawing.palette import get_class_colour
from facadelake.reporting.elevations.facades import Facade
from facadelake.reporting.elevations.marks import DefectMark
from facadelake.reporting.elevations.relief import find_relief_edges, render_relief, render_shaded_relief
from facadelake.reporting.elevations.storeys import StoreyBase

_WIDTH_PX = 1000
_MIN_CELL_M = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class FacadeOverview:
    """A facade's elevation at low resolution (RGB); its picture is ``width_m`` by ``height_m`` large."""

    facade: Facade
    picture: UInt8Image
    width_m: float
    height_m: float


def create_overview(facade: Facade, picture: UInt8Image, cell_m: float) -> FacadeOverview:
    """The overview of an elevation's ``picture`` (rows, columns, RGB) with cells of ``cell_m``."""
    rows, columns = picture.shape[:2]
    scale = min(1.0, _WIDTH_PX / columns)
    size = (max(1, round(columns * scale)), max(1, round(rows * scale)))
    reduced = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return FacadeOverview(facade=facade, picture=reduced, width_m=columns * cell_m, height_m=rows * cell_m)


def render_model_overview(facade: Facade, surface: Surface, building: BuildingModel) -> FacadeOverview:
    """The overview of a facade from the shaded model, for facades without an elevation."""
    cell_m = max((facade.u_max_m - facade.u_min_m) / _WIDTH_PX, _MIN_CELL_M)
    relief = render_relief(facade, surface, cell_m)
    picture = render_shaded_relief(relief, building)
    picture[find_relief_edges(relief, building)] = 110
    return create_overview(facade, picture, cell_m)


def draw_defect_location(axes: Axes, overview: FacadeOverview, storeys: Sequence[StoreyBase], mark: DefectMark) -> None:
    """Draw a facade with a ring at the location of a defect.

    Args:
        axes: axes to draw into; u and v of frame ``facade``, metres.
        overview: picture of the facade.
        storeys: storeys whose base levels are drawn as lines, from the lowest up.
        mark: the defect.
    """
    facade, colour = overview.facade, get_class_colour(mark.defect_class)
    left, top = facade.u_min_m, facade.v_max_m
    right, bottom = left + overview.width_m, top - overview.height_m
    axes.imshow(overview.picture, extent=(left, right, bottom, top), interpolation="antialiased")
    for storey in storeys:
        level = storey.z_site_m
        if bottom <= level <= top:
            axes.axhline(level, color="white", linewidth=1.2, alpha=0.6)
            axes.axhline(level, color="#202020", linewidth=0.5, dashes=(8, 4))
    u, v, _ = facade.uvw_from_site(mark.centre_site_m[None])[0]
    for ring in mark.outlines_site_m:
        uv = facade.uvw_from_site(ring)[:, :2]
        axes.add_patch(Polygon(uv, closed=True, fill=False, edgecolor=colour, linewidth=1.0))
    for width, ink in ((4.5, "white"), (2.2, colour)):
        axes.plot(
            [u], [v], "o", markersize=19, markerfacecolor="none", markeredgecolor=ink, markeredgewidth=width, zorder=4
        )
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_aspect("equal", adjustable="box", anchor="NW")
    axes.tick_params(labelsize=7.5)
