"""What is worth flying again: the parts of the facades that no photograph shows, as rectangles.

What the building itself hides from every camera in front of it is no matter of a flight, and is told apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import pyarrow as pa

from facadelake.building.surface import Surface
from facadelake.core.arrays import BoolArray, Float64N, Float64Nx3, Int64Array
from facadelake.coverage.cells import CELL_M
from facadelake.coverage.summary import collect_names

LEAST_AREA_M2 = 0.5  # of surface that is worth a flight
STANDOFF_M = 3.0  # of a camera that flies close to the wall, square to it
_GRAZING_DEG = 80.0
_JOINED = np.ones((3, 3), dtype=np.uint8)  # widens cells by one, so that a gap of two is bridged
_FILLED_SHARE = 0.6  # a rectangle with a smaller share of cells that are not imaged is divided
_SMALLEST_SIDE = 4  # cells; smaller rectangles are not divided
_OFF_SURFACE_M = 0.08
_LOWEST_CAMERA_M = 1.0  # above the lowest point of the building
_ANGLES_DEG = (0, 15, -15, 30, -30, 45, -45, 60, -60, 75)


@dataclass(frozen=True, kw_only=True)
class UnimagedArea:
    """A rectangle of a facade (frame ``facade``, metres) with ``area_m2`` of surface that no photograph shows.

    ``outcome``: what prevents it for the larger part. ``storeys``: from the lowest up.
    """

    facade: str
    outcome: str
    storeys: tuple[str, ...]
    u_min_m: float
    u_max_m: float
    v_min_m: float
    v_max_m: float
    area_m2: float


@dataclass(frozen=True, kw_only=True)
class ReflightList:
    """What no photograph of a campaign shows.

    ``areas``: of at least ``least_m2``, the largest first, of what a flight could see; ``small_count``, ``small_m2``:
    those that are smaller. ``out_of_sight_m2``: what the building hides from every camera in front of it; None:
    unknown, and all of it is among the areas.
    """

    areas: tuple[UnimagedArea, ...]
    least_m2: float
    small_count: int
    small_m2: float
    out_of_sight_m2: float | None

    @property
    def visible_m2(self) -> float:
        """What a flight could see, in square metres."""
        return sum(area.area_m2 for area in self.areas) + self.small_m2

    def describe(self) -> str:
        """The totals in a sentence or two."""
        text = f"A flight could see {self.visible_m2:.1f} m² that no photograph shows"
        if self.small_count:
            text += (
                f", of which {self.small_m2:.1f} m² in {self.small_count} "
                f"{'area' if self.small_count == 1 else 'areas'} of less than {self.least_m2:g} m² "
                f"{'is' if self.small_count == 1 else 'are'} not listed"
            )
        if self.out_of_sight_m2 is None:
            return f"{text}; how much of it the building hides from every side is unknown without its model."
        return (
            f"{text}. {self.out_of_sight_m2:.1f} m² more can be seen by no flight: the building hides them from every "
            f"camera {STANDOFF_M:g} m in front."
        )


def list_reflights(coverage: pa.Table, surface: Surface | None, *, least_m2: float = LEAST_AREA_M2) -> ReflightList:
    """List what is worth flying again.

    Args:
        coverage: table ``coverage`` of one campaign.
        surface: surface of the building, which tells what no flight can see; None: unknown.
        least_m2: smallest area that is listed, square metres.
    """
    missing = coverage.filter(pa.array(coverage.column("imaged_count").to_numpy() == 0))
    hidden = np.zeros(len(missing), dtype=bool) if surface is None else find_out_of_sight(missing, surface)
    areas = find_unimaged_areas(missing.filter(pa.array(~hidden)))
    small = [area for area in areas if area.area_m2 < least_m2]
    return ReflightList(
        areas=tuple(area for area in areas if area.area_m2 >= least_m2),
        least_m2=least_m2,
        small_count=len(small),
        small_m2=sum(area.area_m2 for area in small),
        out_of_sight_m2=None if surface is None else float(missing.column("area_m2").to_numpy()[hidden].sum()),
    )


def find_out_of_sight(coverage: pa.Table, surface: Surface) -> BoolArray:
    """Which cells (n,) the building hides from every camera ``STANDOFF_M`` in front of them.

    Cameras are at up to 75 degrees to the side, up and down, not nearer to the ground than a metre.

    Args:
        coverage: rows of table ``coverage``.
        surface: surface of the building.
    """
    xyz, normal = (
        np.column_stack([coverage.column(name).to_numpy() for name in names]).reshape(-1, 3)
        for names in (("x_site_m", "y_site_m", "z_site_m"), ("normal_x", "normal_y", "normal_z"))
    )
    lowest_m = float(surface.vertices_site_m[:, 2].min()) + _LOWEST_CAMERA_M
    hidden = np.ones(len(coverage), dtype=bool)
    for up_deg in _ANGLES_DEG:
        for side_deg in _ANGLES_DEG:
            rows = np.flatnonzero(hidden)
            if len(rows) == 0:
                return hidden
            direction = _turn(normal[rows], up_deg, side_deg)
            cosine = np.einsum("ij,ij->i", direction, normal[rows])
            length_m = STANDOFF_M / np.maximum(cosine, 1e-6)
            # Before a low cell there is always room for a camera that looks level or down.
            is_above_ground = (xyz[rows, 2] + length_m * direction[:, 2] >= lowest_m) | (direction[:, 2] >= 0)
            is_free = surface.cast(xyz[rows] + _OFF_SURFACE_M * normal[rows], direction).distance_m > length_m
            hidden[rows[is_free & is_above_ground & (cosine > np.cos(np.radians(_GRAZING_DEG)))]] = False
    return hidden


def _turn(normal: Float64Nx3, up_deg: float, side_deg: float) -> Float64Nx3:
    """Unit directions (n, 3) that lie ``up_deg`` above and ``side_deg`` beside the normals (n, 3)."""
    horizontal = np.column_stack([-normal[:, 1], normal[:, 0], np.zeros(len(normal))])
    length = np.linalg.norm(horizontal, axis=1, keepdims=True)
    beside = np.where(length > 1e-6, horizontal / np.maximum(length, 1e-6), [1.0, 0.0, 0.0])
    above = np.cross(normal, beside)
    up, side = np.radians(up_deg), np.radians(side_deg)
    turned: Float64Nx3 = np.cos(up) * (np.cos(side) * normal + np.sin(side) * beside) + np.sin(up) * above
    return turned


def find_unimaged_areas(coverage: pa.Table) -> list[UnimagedArea]:
    """The areas of table ``coverage`` of one campaign that no photograph shows, the largest first.

    Cells up to two apart are one rectangle; a rectangle that is largely imaged is divided.
    """
    missing = coverage.filter(pa.array(coverage.column("imaged_count").to_numpy() == 0))
    facade = collect_names(missing, "facade")
    areas = []
    for name in np.unique(facade):
        own = missing.filter(pa.array(facade == name))
        column, row = (own.column(axis).to_numpy() for axis in ("cell_column", "cell_row"))
        left, low = int(column.min()), int(row.min())
        grid = np.zeros((int(row.max()) - low + 1, int(column.max()) - left + 1), dtype=np.uint8)
        grid[row - low, column - left] = 1
        count, labels = cv2.connectedComponents(cv2.dilate(grid, _JOINED), connectivity=8)
        labels = np.where(grid > 0, labels, 0)
        for label in range(1, count):
            for top, bottom, first, last in _divide_rectangle(labels == label, 0, 0):
                inside = (row >= low + top) & (row < low + bottom) & (column >= left + first) & (column < left + last)
                inside &= labels[row - low, column - left] == label
                areas.append(_build_area(own, inside, str(name)))
    return sorted(areas, key=lambda one: (-one.area_m2, one.facade, one.u_min_m, one.v_min_m))


def _divide_rectangle(cells: BoolArray, top: int, left: int) -> Iterator[tuple[int, int, int, int]]:
    """Rectangles (first and last row, first and last column, the last ones exclusive) that contain all cells."""
    rows, columns = np.flatnonzero(cells.any(axis=1)), np.flatnonzero(cells.any(axis=0))
    if len(rows) == 0:
        return
    part = cells[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    top, left = top + int(rows[0]), left + int(columns[0])
    height, width = part.shape
    if part.mean() >= _FILLED_SHARE or max(height, width) <= _SMALLEST_SIDE:
        yield top, top + height, left, left + width
        return
    if width >= height:
        half = _find_cut(part.mean(axis=0))
        yield from _divide_rectangle(part[:, :half], top, left)
        yield from _divide_rectangle(part[:, half:], top, left + half)
    else:
        half = _find_cut(part.mean(axis=1))
        yield from _divide_rectangle(part[:half], top, left)
        yield from _divide_rectangle(part[half:], top + half, left)


def _find_cut(filled: Float64N) -> int:
    """Where to cut a rectangle: at the largest change of the filled share along its longer side."""
    return int(np.argmax(np.abs(np.diff(filled)))) + 1


def _build_area(cells: pa.Table, inside: BoolArray, facade: str) -> UnimagedArea:
    own = cells.filter(pa.array(inside))
    area = own.column("area_m2").to_numpy()
    outcome = collect_names(own, "coverage_outcome")
    words = np.unique(outcome)
    storey, level = collect_names(own, "storey"), own.column("z_site_m").to_numpy()
    storeys = sorted((one for one in np.unique(storey) if one), key=lambda one: float(level[storey == one].min()))
    column, row = _find_span(own, "cell_column"), _find_span(own, "cell_row")
    return UnimagedArea(
        facade=facade,
        outcome=str(max(words, key=lambda word: float(area[outcome == word].sum()))),
        storeys=tuple(str(one) for one in storeys),
        u_min_m=float(column[0]) * CELL_M,
        u_max_m=float(column[1] + 1) * CELL_M,
        v_min_m=float(row[0]) * CELL_M,
        v_max_m=float(row[1] + 1) * CELL_M,
        area_m2=float(area.sum()),
    )


def _find_span(cells: pa.Table, column: str) -> Int64Array:
    values = cells.column(column).to_numpy()
    return np.array([values.min(), values.max()], dtype=np.int64)
