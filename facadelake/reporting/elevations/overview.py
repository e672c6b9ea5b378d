"""A facade in small, and the place of a defect on it."""

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
_FINEST_M = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class FacadeOverview:
    """A facade's elevation as a small ``picture`` (RGB) that spans ``width_m`` and ``height_m`` from its top left."""

    facade: Facade
    picture: UInt8Image
    width_m: float
    height_m: float

    @classmethod
    def of(cls, facade: Facade, picture: UInt8Image, cell_m: float) -> FacadeOverview:
        """Made from an elevation's ``picture`` of cells ``cell_m`` wide."""
        rows, columns = picture.shape[:2]
        scale = min(1.0, _WIDTH_PX / columns)
        size = (max(1, round(columns * scale)), max(1, round(rows * scale)))
        small = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        return cls(facade=facade, picture=small, width_m=columns * cell_m, height_m=rows * cell_m)


def render_model_overview(facade: Facade, surface: Surface, building: BuildingModel) -> FacadeOverview:
    """The facade as a grey drawing of the model, where its elevation is not drawn."""
    cell_m = max((facade.u_max_m - facade.u_min_m) / _WIDTH_PX, _FINEST_M)
    relief = render_relief(facade, surface, cell_m)
    picture = render_shaded_relief(relief, building)
    picture[find_relief_edges(relief, building)] = 110
    return FacadeOverview.of(facade, picture, cell_m)


def draw_defect_location(axes: Axes, backdrop: FacadeOverview, storeys: Sequence[StoreyBase], mark: DefectMark) -> None:
    """Draw the facade and mark the defect's place on it; axes in metres along it and above its lowest storey."""
    facade, colour = backdrop.facade, get_class_colour(mark.defect_class)
    zero = storeys[0].z_site_m if storeys else facade.v_min_m
    top = facade.v_max_m - zero
    axes.imshow(
        backdrop.picture, extent=(0.0, backdrop.width_m, top - backdrop.height_m, top), interpolation="antialiased"
    )
    for storey in storeys:
        level = storey.z_site_m - zero
        if top - backdrop.height_m <= level <= top:
            axes.axhline(level, color="white", linewidth=1.2, alpha=0.6)
            axes.axhline(level, color="#202020", linewidth=0.5, dashes=(8, 4))
    u, v = locate_on_facade(facade, mark, zero)
    for ring in mark.outlines_site_m:
        uv = facade.uvw_from_site(ring)[:, :2] - [facade.u_min_m, zero]
        axes.add_patch(Polygon(uv, closed=True, fill=False, edgecolor=colour, linewidth=1.0))
    for width, ink in ((4.5, "white"), (2.2, colour)):
        axes.plot(
            [u], [v], "o", markersize=19, markerfacecolor="none", markeredgecolor=ink, markeredgewidth=width, zorder=4
        )
    axes.set_xlim(0.0, backdrop.width_m)
    axes.set_ylim(top - backdrop.height_m, top)
    axes.set_aspect("equal", adjustable="box", anchor="NW")
    axes.tick_params(labelsize=7.5)


def locate_on_facade(facade: Facade, mark: DefectMark, zero_site_m: float) -> tuple[float, float]:
    """Metres along the facade from its left, and above ``zero_site_m``, of a defect."""
    u, v, _ = facade.uvw_from_site(mark.centre_site_m[None])[0]
    return float(u - facade.u_min_m), float(v - zero_site_m)
