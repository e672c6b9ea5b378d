"""Regions of the jackknife: compact, of like size, and the same for a block that differs by a few points."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.random import Generator

from facadelake.core.arrays import Float64Nx3
from facadelake.georeferencing.adjustment.uncertainty import _assign_regions


def _make_facade(rng: Generator, count: int, azimuth_deg: float) -> Float64Nx3:
    along, up = rng.uniform(-30, 30, count), rng.uniform(0, 12, count)
    azimuth = np.radians(azimuth_deg)
    return np.stack([along * np.sin(azimuth), along * np.cos(azimuth), up], axis=1) + rng.normal(0, 0.02, (count, 3))


def _make_courtyard(rng: Generator) -> Float64Nx3:
    walls = [_make_facade(rng, count, azimuth) for count, azimuth in ((2000, 0), (600, 90), (1500, 2), (300, 88))]
    offsets = ([30, 0, 0], [0, 30, 0], [-30, 0, 0], [0, -30, 0])
    return np.vstack([wall + offset for wall, offset in zip(walls, offsets, strict=True)])


@pytest.mark.parametrize("azimuth_deg", [0, 37, 90])
def test_a_facade_is_cut_into_eight_pieces_along_itself(azimuth_deg: float) -> None:
    xyz = _make_facade(np.random.default_rng(1), 4000, azimuth_deg)
    region = _assign_regions(xyz)
    extent = [np.ptp(xyz[region == number, :2], axis=0).max() for number in range(8)]
    assert max(extent) < 2 * 60 / 8  # m
    assert np.bincount(region, minlength=8).min() > len(xyz) // 16


def test_a_few_points_more_change_single_memberships_only() -> None:
    rng = np.random.default_rng(2)
    xyz = _make_courtyard(rng)
    region = _assign_regions(xyz)
    fewer = np.delete(xyz, [5, 700, 3000], axis=0) + rng.normal(0, 0.001, (len(xyz) - 3, 3))
    changed = np.mean(_assign_regions(fewer) != np.delete(region, [5, 700, 3000]))
    assert changed < 0.005
    assert len(np.unique(region)) == 8


def test_a_far_point_changes_no_region() -> None:
    xyz = _make_facade(np.random.default_rng(3), 4000, 90)
    far = np.vstack([xyz, [[0.0, 3000.0, 20.0]]])
    assert np.mean(_assign_regions(far)[:-1] != _assign_regions(xyz)) < 0.005
