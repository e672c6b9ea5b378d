"""Defects on a wall of 30 x 10 m, and campaigns that find them with noise."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np

from facadelake.tracking import DefectArrays, TrackedCampaign

SIGMA_M = 0.015
START = datetime(2024, 4, 1, 10, 0, tzinfo=UTC)


def draw_wall(seed: int, count: int = 60) -> DefectArrays:
    """True defects."""
    rng = np.random.default_rng(seed)
    return DefectArrays(
        defect_id=np.array([f"T{k}" for k in range(count)], dtype=object),
        defect_class=rng.integers(0, 3, count),
        facade=np.array(["S"] * count, dtype=object),
        xyz_site_m=np.column_stack([rng.uniform(0, 30, count), np.zeros(count), rng.uniform(0, 10, count)]),
        covariance_m2=np.tile(SIGMA_M**2 * np.eye(3), (count, 1, 1)),
        normal_site=np.tile([0.0, -1.0, 0.0], (count, 1)),
        width_m=rng.uniform(0.15, 0.6, count),
        height_m=rng.uniform(0.15, 0.6, count),
    )


def find_defects(
    wall: DefectArrays,
    number: int,
    *,
    recall: float = 0.9,
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    seed: int = 0,
) -> TrackedCampaign:
    """A campaign that finds a share of the defects, shifted by its frame's offset; ids tell the truth."""
    rng = np.random.default_rng(1000 * seed + number)
    kept = wall.take(rng.permutation(np.flatnonzero(rng.random(len(wall)) < recall)))
    noise = rng.normal(scale=SIGMA_M, size=(len(kept), 3)) + offset_m
    size = np.exp(rng.normal(scale=0.06, size=(2, len(kept))))
    return TrackedCampaign(
        campaign_id=f"c{number}",
        captured_at=START + timedelta(days=180 * number),
        frame_sigma_m=0.03,
        defects=DefectArrays(
            **{
                **vars(kept),
                "xyz_site_m": kept.xyz_site_m + noise,
                "width_m": kept.width_m * size[0],
                "height_m": kept.height_m * size[1],
            }
        ),
    )
