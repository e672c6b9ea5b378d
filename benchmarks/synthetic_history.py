"""Drawn histories of a building without photographs: defects on four facades, and campaigns that detect them.

A defect is drawn with a place, a class and a size; it appears, grows, is repaired, and comes back. Each campaign images
its place or not, and detects what it images with a recall; boxes scatter, frames are offset, and some detections are
false. ``benchmarks.synthetic_tracking`` tracks them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import shapely

from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import add_run_keys, table_from_rows
from facadelake.evaluation.history import TrueDefect
from facadelake.tracking import CampaignRecords, DefectArrays, TrackedCampaign, summarise_sizes
from facadelake.tracking.campaign_defects import CLASSES
from facadelake.tracking.size_change import DefectSizes, compute_medians
from schemas.vocabulary import DefectClass, TrendQuantity

BUILDING = "drawn"
ORIGIN = SiteOrigin(lon_deg=8.4, lat_deg=48.9, height_ellipsoidal_m=170.0)
MAP_CRS = "EPSG:25832"
# Outward normal, direction to the right as seen from outside, and first corner as shares of length and depth.
_WALLS = {
    "S": ((0, -1, 0), (1, 0, 0), (0, 0)),
    "E": ((1, 0, 0), (0, 1, 0), (1, 0)),
    "N": ((0, 1, 0), (-1, 0, 0), (1, 1)),
    "W": ((-1, 0, 0), (0, -1, 0), (0, 1)),
}
_FIRST_DAY = datetime(2006, 4, 1, tzinfo=UTC)


@dataclass(frozen=True, kw_only=True)
class LookRates:
    """What looks say: shares of verdicts on a defect that is there as it was, there in another size, and gone; the rest
    is undecided."""

    there_same: float = 0.85
    there_gone: float = 0.001
    changed_same: float = 0.2
    changed_gone: float = 0.001
    gone_gone: float = 0.80
    gone_same: float = 0.02
    hidden: float = 0.5  # of the places that a campaign does not image; the others are not in view


@dataclass(frozen=True, kw_only=True)
class HistoryRecipe:
    """Numbers of a drawn history. Shares of defects are by campaign; sigmas are those of the campaigns on record.

    ``box_sigma``: of the logarithm of the extents of one box. ``surface_sigma_m``, ``normal_sigma_m``: of a defect's
    place; ``frame_sigma_m`` of a campaign's frame, ``facade_sigma_m`` of a facade in it.
    """

    defects: int = 60
    campaigns: int = 5
    recall: float = 0.7
    false_share: float = 0.1
    new_share: float = 0.1
    repaired_share: float = 0.08
    reopened_share: float = 0.1
    grown_share: float = 0.15
    growth: float = 1.4
    imaged_share: float = 0.95
    other_class_share: float = 0.04
    box_sigma: float = 0.08
    surface_sigma_m: float = 0.010
    normal_sigma_m: float = 0.020
    frame_sigma_m: float = 0.03
    facade_sigma_m: float = 0.005
    length_m: float = 40.0
    height_m: float = 15.0
    looks: LookRates = field(default_factory=LookRates)

    @property
    def area_m2(self) -> float:
        """Area of the four facades."""
        return 4 * self.length_m * self.height_m


@dataclass(kw_only=True)
class _DrawnDefect:
    """A true defect: its place on a wall, and by campaign its size factor, whether it exists and is imaged."""

    name: str
    wall: str
    u_m: float
    v_m: float
    defect_class: int
    width_m: float
    height_m: float
    crack_mm: float
    factor: list[float] = field(default_factory=list)
    exists: list[bool] = field(default_factory=list)
    imaged: list[bool] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True, eq=False)
class SyntheticHistory:
    """Campaigns as tracking takes them, the true defect of each defect, and the truth."""

    recipe: HistoryRecipe
    campaigns: tuple[str, ...]
    records: tuple[CampaignRecords, ...]
    true_ids: Mapping[tuple[str, str], str | None]
    truth: Mapping[str, Sequence[TrueDefect]]


def draw_history(recipe: HistoryRecipe, seed: int) -> SyntheticHistory:
    """Draw a history."""
    rng = np.random.default_rng(seed)
    defects = _draw_truth(recipe, rng)
    names = tuple(f"{(_FIRST_DAY + timedelta(days=365 * k)):%Y-%m}" for k in range(recipe.campaigns))
    records, true_ids = [], {}
    for number, name in enumerate(names):
        found = [d for d in defects if d.exists[number] and d.imaged[number] and rng.random() < recipe.recall]
        false = [_draw_defect(recipe, rng, "", number) for _ in range(rng.poisson(recipe.false_share * recipe.defects))]
        records.append(_detect(recipe, rng, name, number, [*found, *false]))
        true_ids |= {(name, f"{name}-{row:05d}"): defect.name or None for row, defect in enumerate([*found, *false])}
    return SyntheticHistory(
        recipe=recipe,
        campaigns=names,
        records=tuple(records),
        true_ids=true_ids,
        truth={defect.name: _describe_truth(defect, names) for defect in defects},
    )


def _draw_truth(recipe: HistoryRecipe, rng: np.random.Generator) -> list[_DrawnDefect]:
    """All true defects; each lists every campaign."""
    defects: list[_DrawnDefect] = []
    for number in range(recipe.campaigns):
        born = recipe.defects if not number else max(1, rng.poisson(recipe.new_share * recipe.defects))
        for _ in range(born):
            defects.append(_draw_defect(recipe, rng, f"D{len(defects):05d}", number))
        for defect in defects:
            _age(recipe, rng, defect, number)
    return defects


def _draw_defect(recipe: HistoryRecipe, rng: np.random.Generator, name: str, number: int) -> _DrawnDefect:
    """A defect that appears in campaign ``number``."""
    return _DrawnDefect(
        name=name,
        wall=str(rng.choice(list(_WALLS))),
        u_m=rng.uniform(0, recipe.length_m),
        v_m=rng.uniform(0, recipe.height_m),
        defect_class=int(rng.integers(len(CLASSES))),
        width_m=float(np.exp(rng.normal(-0.7, 0.5))),
        height_m=float(np.exp(rng.normal(-0.7, 0.5))),
        crack_mm=float(np.exp(rng.normal(0.0, 0.5))),
        factor=[1.0] * (number + (not name)),
        exists=[False] * number + [True] * (not name),
        imaged=(rng.random(number) < recipe.imaged_share).tolist() + [True] * (not name),
    )


def _age(recipe: HistoryRecipe, rng: np.random.Generator, defect: _DrawnDefect, number: int) -> None:
    """What a defect is in campaign ``number``; a grown one keeps its centre or one of its ends."""
    is_first = len(defect.exists) == number and not any(defect.exists)
    existed = number > 0 and defect.exists[-1]
    draw = rng.random()
    factor = defect.factor[-1] if defect.factor else 1.0
    exists = True
    if not is_first and existed and draw < recipe.repaired_share:
        exists = False
    elif not is_first and not existed:
        exists = draw < recipe.reopened_share
    elif not is_first and draw < recipe.repaired_share + recipe.grown_share:
        factor *= recipe.growth
        grown_m = defect.width_m * factor * (1 - 1 / recipe.growth)
        defect.u_m += float(rng.choice([-0.5, 0.0, 0.5])) * grown_m
    defect.factor.append(factor)
    defect.exists.append(exists)
    defect.imaged.append(bool(rng.random() < recipe.imaged_share))


def _describe_truth(defect: _DrawnDefect, names: Sequence[str]) -> list[TrueDefect]:
    return [
        TrueDefect(
            true_id=defect.name,
            campaign_id=name,
            defect_class=DefectClass(CLASSES[defect.defect_class]),
            exists=exists,
            imaged=imaged,
            width_m=factor * defect.width_m if exists else 0.0,
            height_m=factor * defect.height_m if exists else 0.0,
        )
        for name, exists, imaged, factor in zip(names, defect.exists, defect.imaged, defect.factor, strict=True)
    ]


def _detect(
    recipe: HistoryRecipe, rng: np.random.Generator, name: str, number: int, defects: Sequence[_DrawnDefect]
) -> CampaignRecords:
    """The defects of a campaign as measured from one to nine boxes each."""
    count = len(defects)
    frame_m = rng.normal(0, recipe.frame_sigma_m, 3)
    facade_m = {wall: rng.normal(0, recipe.facade_sigma_m, 3) for wall in _WALLS}
    boxes = 1 + rng.binomial(8, 0.4, count)
    owner = np.repeat(np.arange(count), boxes)
    factor = np.array([defect.factor[number] for defect in defects])
    extents = factor[:, None] * np.array([[defect.width_m, defect.height_m] for defect in defects]).reshape(-1, 2)
    drawn = extents[owner] * np.exp(rng.normal(0, recipe.box_sigma, (len(owner), 2)))
    normal, right = (np.array([_WALLS[d.wall][k] for d in defects], dtype=np.float64).reshape(-1, 3) for k in (0, 1))
    corner = recipe.length_m * np.array([[*_WALLS[d.wall][2], 0] for d in defects], dtype=np.float64).reshape(-1, 3)
    place = np.array([[defect.u_m, defect.v_m] for defect in defects]).reshape(-1, 2)
    # The centre of a box scatters by its edges; the mean of several boxes less.
    place += extents * rng.normal(0, recipe.box_sigma, (count, 2)) / np.sqrt(2 * boxes)[:, None]
    errors = rng.normal(0, 1, (count, 3)) * [recipe.surface_sigma_m, recipe.surface_sigma_m, recipe.normal_sigma_m]
    up = np.array([0.0, 0.0, 1.0])
    xyz = (
        corner + (place[:, :1] + errors[:, :1]) * right + (place[:, 1:] + errors[:, 1:2]) * up + errors[:, 2:] * normal
    )
    xyz += frame_m + np.array([facade_m[defect.wall] for defect in defects]).reshape(-1, 3)
    along = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    covariance = recipe.surface_sigma_m**2 * along + recipe.normal_sigma_m**2 * normal[:, :, None] * normal[:, None, :]
    other = rng.random(count) < recipe.other_class_share
    classes = np.where(other, rng.integers(len(CLASSES), size=count), [defect.defect_class for defect in defects])
    arrays = DefectArrays(
        defect_id=np.array([f"{name}-{row:05d}" for row in range(count)], dtype=object),
        defect_class=classes.astype(np.int64),
        facade=np.array([defect.wall for defect in defects], dtype=object),
        xyz_site_m=xyz,
        covariance_m2=covariance,
        normal_site=normal,
        width_m=compute_medians(drawn[:, 0], owner, count),
        height_m=compute_medians(drawn[:, 1], owner, count),
    )
    is_crack = classes == CLASSES.index(DefectClass.CRACK)
    crack_sigma = np.where(is_crack, 0.1, np.nan)
    crack = np.log([defect.crack_mm for defect in defects]) + crack_sigma * rng.normal(size=count)
    no_pixels = np.zeros(len(owner))
    sizes = {
        TrendQuantity.LENGTH: summarise_sizes(np.log(np.hypot(drawn[:, 0], drawn[:, 1])), no_pixels, owner, count),
        TrendQuantity.AREA: summarise_sizes(np.log(drawn.prod(axis=1)), no_pixels, owner, count),
        TrendQuantity.CRACK_WIDTH: DefectSizes(
            log_size=crack, sigma=crack_sigma, per_blur_px=np.zeros(count), blur_px=np.zeros(count)
        ),
    }
    captured_at = _FIRST_DAY + timedelta(days=365 * number)
    return CampaignRecords(
        run_id=f"run-{name}",
        inputs_sha256="",
        tracked=TrackedCampaign(
            campaign_id=name, captured_at=captured_at, frame_sigma_m=recipe.frame_sigma_m, defects=arrays
        ),
        defect_table=_make_table(arrays, sizes, name),
        sizes=sizes,
        posed={},
        root=Path(),
    )


def _make_table(defects: DefectArrays, sizes: Mapping[TrendQuantity, DefectSizes], name: str) -> pa.Table:
    """Rows of table ``defects`` as the lake has them."""
    geo, on_map = ORIGIN.geo_from_site(defects.xyz_site_m), ORIGIN.map_from_site(defects.xyz_site_m, MAP_CRS)
    crack = np.exp(sizes[TrendQuantity.CRACK_WIDTH].log_size)
    geometry = shapely.to_wkb(shapely.points(geo))
    rows: list[dict[str, Any]] = [
        {
            "defect_id": defects.defect_id[row], "defect_class": CLASSES[defects.defect_class[row]], "severity": "low",
            "severity_rule": "width_and_extent_v1", "facade": defects.facade[row], "spread_m": 0.0, "photo_count": 3,
            "score": 1.0, "best_photo_id": "photo.jpg", "element_guid": "wall", "ifc_class": "IfcWall",
            **dict(zip(("x_site_m", "y_site_m", "z_site_m"), defects.xyz_site_m[row].tolist(), strict=True)),
            **dict(zip(("lon_deg", "lat_deg", "height_ellipsoidal_m"), geo[row].tolist(), strict=True)),
            **dict(zip(("east_map_m", "north_map_m", "height_map_m"), on_map[row].tolist(), strict=True)),
            **dict(zip(("normal_x", "normal_y", "normal_z"), defects.normal_site[row].tolist(), strict=True)),
            "width_m": float(defects.width_m[row]), "height_m": float(defects.height_m[row]),
            "length_m": float(np.exp(sizes[TrendQuantity.LENGTH].log_size[row])),
            "area_m2": float(np.exp(sizes[TrendQuantity.AREA].log_size[row])),
            "crack_width_mm": float(crack[row]) if np.isfinite(crack[row]) else None,
            "geometry": geometry[row],
        }
        for row in range(len(defects))
    ]  # fmt: skip
    table = table_from_rows("defects", rows)
    return add_run_keys("defects", table, building_id=BUILDING, campaign_id=name, run_id=f"run-{name}")
