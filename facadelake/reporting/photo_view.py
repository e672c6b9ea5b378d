"""Comparison of a photograph with the model's virtual view, depth and elements (the paper's Fig. 8)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from facadelake.building.surface import Surface, ViewImages, render_view_images, render_virtual_photograph
from facadelake.campaigns import read_committed_model, read_committed_tables, resolve_campaign
from facadelake.core.arrays import BoolArray, Float32Array, Float64Array, UInt8Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.photo_names import PhotoNames
from facadelake.core.pose_table import read_posed_cameras
from facadelake.core.progress import report_progress
from facadelake.registry import Building
from facadelake.reporting.drawing.palette import OTHER_COLOUR, escape_mathtext
from facadelake.reporting.drawing.photograph import name_photograph_files, read_photograph
from schemas.vocabulary import PoseSource

_PANEL_IN = 8.0
_MIN_PANEL_PX = 800
_GAP_IN, _TOP_IN, _FOOT_IN = 0.4, 0.75, 0.8
_BORDER = 0.92  # share by which borders are darkened, to separate elements of one class
_NO_ELEMENT = (1.0, 1.0, 1.0)
_NOT_TARGET = (0.80, 0.80, 0.80)  # in the model, not part of the building
_CLASS_COLOURS = (
    ("IfcWall", "#d9b38c"),
    ("IfcWindow", "#56b4e9"),
    ("IfcDoor", "#8c5a2b"),
    ("IfcSlab", "#999999"),
    ("IfcRoof", "#d55e00"),
    ("IfcColumn", "#cc79a7"),
    ("IfcBeam", "#b39dbd"),
    ("IfcRailing", "#009e73"),
    ("IfcCurtainWall", "#0072b2"),
    ("IfcStair", "#e69f00"),
    ("IfcCovering", "#f0e442"),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewPanels:
    """The images of a sheet, all in one pixel grid: ``photograph`` and ``virtual`` (h, w, 3) RGB, ``images`` (h, w)."""

    photograph: UInt8Array
    virtual: UInt8Array
    images: ViewImages


def draw_view_sheet(panels: ViewPanels, *, title: str, note: str) -> Figure:
    """The sheet: four panels, a colour bar of depth and a legend of elements.

    One pixel of the images is one pixel of the sheet, or an integer number of pixels where the images are small.
    """
    height, width = panels.photograph.shape[:2]
    zoom = max(1, round(_MIN_PANEL_PX / width))
    panel_in = _PANEL_IN * height / width
    sheet_in = np.array([2 * _PANEL_IN + 3 * _GAP_IN, _FOOT_IN + _TOP_IN + _GAP_IN + 2 * panel_in])
    figure = Figure(figsize=tuple(sheet_in), dpi=width * zoom / _PANEL_IN)
    FigureCanvasAgg(figure)

    def add_axes(left_in: float, bottom_in: float, height_in: float) -> Axes:
        across, down = sheet_in
        return figure.add_axes((left_in / across, bottom_in / down, _PANEL_IN / across, height_in / down))

    left, right, low, high = _GAP_IN, 2 * _GAP_IN + _PANEL_IN, _FOOT_IN, _FOOT_IN + panel_in + _GAP_IN
    _draw_panel(add_axes(left, high, panel_in), panels.photograph, "Photograph")
    _draw_panel(add_axes(right, high, panel_in), panels.virtual, "Virtual view of the model")
    bar = add_axes(left, low - 0.25, 0.15)
    _draw_depth(add_axes(left, low, panel_in), bar, panels.images.depth_m)
    _draw_elements(add_axes(right, low, panel_in), panels.images)
    figure.text(_GAP_IN / sheet_in[0], 1 - 0.32 / sheet_in[1], escape_mathtext(title), fontsize=13)
    figure.text(_GAP_IN / sheet_in[0], 0.12 / sheet_in[1], escape_mathtext(note), fontsize=9, color="#404040")
    return figure


def _draw_panel(axes: Axes, picture: UInt8Array | Float64Array, title: str) -> None:
    axes.imshow(picture, interpolation="nearest")
    axes.set_title(title, loc="left", fontsize=10)
    axes.set_axis_off()


def _draw_depth(axes: Axes, bar: Axes, depth_m: Float32Array) -> None:
    is_met = np.isfinite(depth_m)
    image = axes.imshow(np.where(is_met, depth_m, np.nan), cmap="viridis_r", interpolation="nearest")
    axes.set_title("Depth of the model along the optical axis (m)", loc="left", fontsize=10)
    axes.set_axis_off()
    if is_met.any():
        axes.figure.colorbar(image, cax=bar, orientation="horizontal").ax.tick_params(labelsize=9)
    else:
        bar.set_axis_off()


def _draw_elements(axes: Axes, images: ViewImages) -> None:
    classes = images.legend.column("ifc_class").to_pylist()
    target = np.zeros(len(classes) + 1, dtype=bool)
    target[images.element[images.target]] = True
    colours = np.array(
        [*(_shade_element(name, i) for i, name in enumerate(classes)), _NO_ELEMENT]
    )  # the last one for no element
    visible = [int(row) for row in np.unique(images.element) if row >= 0]
    for row in visible:
        if not target[row]:
            colours[row] = _NOT_TARGET
    picture = colours[images.element]
    picture[_find_borders(images.element)] *= 1 - _BORDER
    _draw_panel(axes, picture, "Elements of the model, by class")
    axes.legend(
        handles=_list_legend_patches(
            [classes[row] for row in visible if target[row]], any(not target[row] for row in visible)
        ),
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        ncols=6,
        fontsize=9,
        frameon=False,
    )


def _list_legend_patches(classes: Sequence[str], has_other: bool) -> list[Patch]:
    """Legend of the visible elements by class; ``has_other``: some are not part of the building."""
    handles = [
        Patch(facecolor=_get_ifc_colour(name), edgecolor="#404040", label=f"{name.removeprefix('Ifc')} ({number})")
        for name, number in sorted(Counter(classes).items(), key=lambda pair: (-pair[1], pair[0]))
    ]
    if has_other:
        handles.append(Patch(facecolor=_NOT_TARGET, edgecolor="#404040", label="not part of the building"))
    handles.append(Patch(facecolor=_NO_ELEMENT, edgecolor="#404040", label="not in the model"))
    return handles


def _get_ifc_colour(ifc_class: str) -> tuple[float, float, float]:
    """Colour of an IFC class by the beginning of its name: IfcWallStandardCase is drawn as IfcWall."""
    return to_rgb(next((colour for name, colour in _CLASS_COLOURS if ifc_class.startswith(name)), OTHER_COLOUR))


def _shade_element(ifc_class: str, row: int) -> Float64Array:
    """Colour of an element: that of its class, varied in brightness by its row."""
    colour: Float64Array = np.array(_get_ifc_colour(ifc_class)) * (0.82 + 0.06 * (row * 2 % 5 - 2))
    return np.clip(colour + 0.12, 0.0, 1.0)


def _find_borders(element: NDArray[np.int32]) -> BoolArray:
    """Mask of pixels whose left or upper neighbour shows another element."""
    border = np.zeros(element.shape, dtype=bool)
    border[:, 1:] |= element[:, 1:] != element[:, :-1]
    border[1:] |= element[1:] != element[:-1]
    return border


_DEFAULT_WIDTH_PX = 1000


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoView:
    """A written sheet, and the images it shows."""

    photo_id: str
    path: Path
    images: ViewImages


def view_photograph(
    building: Building,
    campaign_id: str,
    photo: str,
    *,
    lake: Path,
    output: Path | None,
    scale: float | None,
    as_of: int | None = None,
) -> PhotoView:
    """Write the sheet of one photograph, and the images of ``render_view_images`` in a ``.npz`` file of the same name.

    Args:
        building: building in the portfolio.
        campaign_id: campaign.
        photo: photo_id, or a unique file name, with or without suffix.
        lake: folder of the lake.
        output: picture to write; None: ``view_<photo>.png`` in the working directory.
        scale: size of a panel relative to the photograph; None: panels 1000 pixels wide.
        as_of: an earlier version of the lake; None: the newest.

    Raises:
        InputDataError: the photograph is unknown or has no pose.
        StoreError: the lake does not contain the campaign.
    """
    campaign = resolve_campaign(building, campaign_id)
    tables = read_committed_tables(building, campaign, ["poses"], lake=lake, as_of=as_of)
    photo_id = _match_photo_id([row["photo_id"] for row in tables["poses"].to_pylist()], photo, building.id, campaign)
    row = next(row for row in tables["poses"].to_pylist() if row["photo_id"] == photo_id)
    posed = read_posed_cameras(tables["poses"]).get(photo_id)
    if posed is None:
        raise InputDataError(
            f"photograph {photo_id} of {building.id} {campaign} has no measured pose "
            f"({row['reason'] or row['pose_source']}); choose a localised photograph"
        )
    model = read_committed_model(building, campaign, tables["buildings"].to_pylist()[0])
    surface = Surface(model)
    scale = scale if scale is not None else min(1.0, _DEFAULT_WIDTH_PX / posed.camera.width_px)
    with report_progress("Rendering the model"):
        images = render_view_images(posed, surface, model.elements, scale)
        virtual = render_virtual_photograph(model, posed, scale=scale).colour
    photograph = _read_resized(building.locate_photographs(campaign) / photo_id, posed, images.depth_m.shape)
    names = name_photograph_files(row["photo_id"] for row in tables["poses"].to_pylist())
    path = output or Path(f"view_{names[photo_id]}.png")
    figure = draw_view_sheet(
        ViewPanels(photograph=photograph, virtual=virtual, images=images),
        title=f"{building.name}, {campaign}: {photo_id}",
        note=_describe_view(images, row),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    images.save(path.with_suffix(".npz"))
    return PhotoView(photo_id=photo_id, path=path, images=images)


def _match_photo_id(photo_ids: list[str], name: str, building_id: str, campaign: str) -> str:
    """The photo_id that ``name`` refers to."""
    match = PhotoNames(photo_ids).match(name)
    if match.photo_id is None:
        raise InputDataError(
            f"{building_id} {campaign}: {match.reason}; photographs are {', '.join(photo_ids[:5])}, ..."
        )
    return match.photo_id


def _read_resized(path: Path, posed: PosedCamera, shape: tuple[int, ...]) -> UInt8Array:
    reduction = next((n for n in (8, 4, 2) if posed.camera.width_px // n >= shape[1]), 1)
    rgb = read_photograph(path, posed.camera, reduction)
    return np.asarray(cv2.resize(rgb, (shape[1], shape[0]), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _describe_view(images: ViewImages, pose: dict[str, object]) -> str:
    """Coverage, distances, number of visible elements and the source of the pose."""
    share = float(images.target.mean())
    depth = images.depth_m[images.target]
    distances = f", {depth.min():.1f} to {depth.max():.1f} m from the camera" if depth.size else ""
    count = len(np.unique(images.element[images.target]))
    return (
        f"The building covers {share:.0%} of the photograph{distances}; {count} of its elements are visible. "
        f"Pose: {PoseSource(str(pose['pose_source']))}."
    )
