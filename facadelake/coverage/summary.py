"""Totals of a campaign's coverage by facade and storey, and what contradicts it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pyarrow as pa
from scipy.spatial import cKDTree

from facadelake.core.arrays import BoolArray, Float64Nx3, RowIndices
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
_LISTED_MIN_M2 = 0.1
_NAMED_DEFECTS = 5
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
    facade, storey = collect_names(coverage, "facade"), collect_names(coverage, "storey")
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


def collect_names(coverage: pa.Table, column: str) -> np.ndarray:
    """A column of names as an array of text; empty where it has none."""
    return np.array([name or "" for name in coverage.column(column).to_pylist()], dtype=np.str_)


def _sum_cells(coverage: pa.Table, rows: BoolArray, facade: str, storey: str) -> CoverageTotal:
    area = coverage.column("area_m2").to_numpy()
    imaged = rows & (coverage.column("imaged_count").to_numpy() > 0)
    searched = rows & (coverage.column("searched_count").to_numpy() > 0)
    outcome = collect_names(coverage, "coverage_outcome")
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
