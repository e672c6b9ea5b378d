"""Totals of a campaign's coverage by facade and storey, and the areas that no photograph shows, as rectangles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np
import pyarrow as pa
from scipy.spatial import cKDTree

from facadelake.core.arrays import BoolArray, Float64N, Float64Nx3, Int64Array, RowIndices
from facadelake.coverage.cells import CELL_M
from schemas.vocabulary import CoverageOutcome

ALL_STOREYS = "all"
# What prevents a cell from being imaged, in words.
OBSTACLES: Mapping[str, str] = MappingProxyType(
    {
        CoverageOutcome.OBSTRUCTED: "something before the wall",
        CoverageOutcome.GRAZING: "grazing views only",
        CoverageOutcome.HIDDEN_BY_MODEL: "hidden by the building",
        CoverageOutcome.NOT_IN_VIEW: "in no photograph",
    }
)
_FILLED_SHARE = 0.6  # a rectangle with a smaller share of cells that are not imaged is divided
_LISTED_MIN_M2 = 0.1
_NAMED_DEFECTS = 5
_SMALLEST_SIDE = 4  # cells; smaller rectangles are not divided
_TYPICAL_SHARE = 0.9


@dataclass(frozen=True, kw_only=True)
class CoverageTotal:
    """Coverage of a storey of a facade, or of a facade (``storey`` "all"): areas of the surface in square metres.

    ``imaged_m2``: photographs show it. ``searched_m2``: the detector processed one of them. ``prevented_m2``: what is
    not imaged, by outcome. ``gsd_mm``: median of the imaged surface. ``found_crack_width_mm``, ``found_patch_mm``: the
    smallest that is found with 90 % probability on 90 % of the surface that was searched; None where that is unknown.
    """

    facade: str
    storey: str
    surface_m2: float
    imaged_m2: float
    searched_m2: float
    prevented_m2: dict[str, float]
    gsd_mm: float | None
    found_crack_width_mm: float | None
    found_patch_mm: float | None

    @property
    def imaged_share(self) -> float:
        """Share of the surface that photographs show."""
        return self.imaged_m2 / self.surface_m2 if self.surface_m2 else 0.0


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


def find_nearest_cells(coverage: pa.Table, xyz_site_m: Float64Nx3, max_gap_m: float = 0.5) -> RowIndices:
    """Rows (n,) of table ``coverage`` of one campaign nearest to points (n, 3) of site; -1 where none is near.

    Args:
        coverage: table ``coverage`` of one campaign, of any.
        xyz_site_m: points on or near the facades, metres.
        max_gap_m: largest distance of a point from the centre of its cell, metres.
    """
    rows: RowIndices = np.full(len(xyz_site_m), -1, dtype=np.int64)
    if len(coverage) and len(xyz_site_m):
        centres = np.column_stack([coverage.column(name).to_numpy() for name in ("x_site_m", "y_site_m", "z_site_m")])
        gap_m, nearest = cKDTree(centres).query(xyz_site_m)
        rows = np.where(gap_m <= max_gap_m, nearest, -1)
    return rows


def describe_contradictions(coverage: pa.Table, defects: pa.Table) -> str:
    """The defects that lie where no photograph should show anything, in a sentence; empty where there are none.

    Args:
        coverage: table ``coverage`` of one campaign.
        defects: its table ``defects``.
    """
    xyz = np.column_stack([defects.column(name).to_numpy() for name in ("x_site_m", "y_site_m", "z_site_m")])
    cells = find_nearest_cells(coverage, xyz.reshape(-1, 3))
    imaged = np.append(coverage.column("imaged_count").to_numpy() > 0, True)[cells]  # -1: no cell
    names = [name for name, known in zip(defects.column("defect_id").to_pylist(), imaged, strict=True) if not known]
    if not names:
        return ""
    shown = ", ".join(names[:_NAMED_DEFECTS]) + (", ..." if len(names) > _NAMED_DEFECTS else "")
    return (
        f"Defects lie where coverage says that no photograph shows the facade ({len(names)}: {shown}): the model, the "
        "as-built surface or the positions of these defects are wrong there."
    )


def summarise_coverage(coverage: pa.Table) -> list[CoverageTotal]:
    """Totals of table ``coverage`` of one campaign: each facade, and its storeys below it from the top down.

    Facades of less than 0.1 m2, such as the rim of a round corner, are left out.
    """
    facade, storey = _collect_names(coverage, "facade"), _collect_names(coverage, "storey")
    level = coverage.column("z_site_m").to_numpy()
    totals = []
    for name in np.unique(facade):
        own = facade == name
        if coverage.column("area_m2").to_numpy()[own].sum() < _LISTED_MIN_M2:
            continue
        totals.append(_sum_cells(coverage, own, str(name), ALL_STOREYS))
        storeys = [one for one in np.unique(storey[own]) if one]
        storeys.sort(key=lambda one: -float(np.median(level[own & (storey == one)])))
        totals += [_sum_cells(coverage, own & (storey == one), str(name), str(one)) for one in storeys]
    return totals


def _collect_names(coverage: pa.Table, column: str) -> np.ndarray:
    return np.array([name or "" for name in coverage.column(column).to_pylist()], dtype=np.str_)


def _sum_cells(coverage: pa.Table, rows: BoolArray, facade: str, storey: str) -> CoverageTotal:
    area = coverage.column("area_m2").to_numpy()
    imaged = rows & (coverage.column("imaged_count").to_numpy() > 0)
    searched = rows & (coverage.column("searched_count").to_numpy() > 0)
    outcome = _collect_names(coverage, "coverage_outcome")
    prevented = {
        str(word): float(area[rows & (outcome == word)].sum()) for word in OBSTACLES if (rows & (outcome == word)).any()
    }
    return CoverageTotal(
        facade=facade,
        storey=storey,
        surface_m2=float(area[rows].sum()),
        imaged_m2=float(area[imaged].sum()),
        searched_m2=float(area[searched].sum()),
        prevented_m2=prevented,
        gsd_mm=_find_quantile(coverage, "gsd_mm", imaged, 0.5),
        found_crack_width_mm=_find_quantile(coverage, "found_crack_width_mm", searched, _TYPICAL_SHARE),
        found_patch_mm=_find_quantile(coverage, "found_patch_mm", searched, _TYPICAL_SHARE),
    )


def _find_quantile(coverage: pa.Table, column: str, rows: BoolArray, share: float) -> float | None:
    """Quantile of a column by area; None where there are no rows, or a value in them is unknown."""
    values = coverage.column(column).to_numpy()[rows]
    if len(values) == 0 or np.isnan(values).any():
        return None
    order = np.argsort(values)
    reached = np.cumsum(coverage.column("area_m2").to_numpy()[rows][order])
    return float(values[order][np.searchsorted(reached, share * reached[-1] - 1e-9)])


def find_unimaged_areas(coverage: pa.Table) -> list[UnimagedArea]:
    """The areas of table ``coverage`` of one campaign that no photograph shows, the largest first.

    Neighbouring cells are one rectangle; a rectangle that is largely imaged is divided.
    """
    missing = coverage.filter(pa.array(coverage.column("imaged_count").to_numpy() == 0))
    facade = _collect_names(missing, "facade")
    areas = []
    for name in np.unique(facade):
        own = missing.filter(pa.array(facade == name))
        column, row = (own.column(axis).to_numpy() for axis in ("cell_column", "cell_row"))
        left, low = int(column.min()), int(row.min())
        grid = np.zeros((int(row.max()) - low + 1, int(column.max()) - left + 1), dtype=np.uint8)
        grid[row - low, column - left] = 1
        count, labels = cv2.connectedComponents(grid, connectivity=8)
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
    outcome = _collect_names(own, "coverage_outcome")
    words = np.unique(outcome)
    storey, level = _collect_names(own, "storey"), own.column("z_site_m").to_numpy()
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
