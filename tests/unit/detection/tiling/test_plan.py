"""Tiles cover the target and nothing else, at the scale that card and photograph require."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facadelake.detection.tiling.plan import OVERLAP_RATIO, TilePass, plan_tile_passes
from tests.unit.detection.blobs import make_blob_card


def plan_passes(
    width: int = 8000, height: int = 6000, *, wants_mm: tuple[float, ...] = (), gsd_mm: float | None = None
) -> tuple[TilePass, ...]:
    return plan_tile_passes(make_blob_card(416, wants_mm).input, width_px=width, height_px=height, gsd_mm=gsd_mm)


@given(st.integers(840, 9000), st.integers(300, 7000))
def test_native_tiles_cover_the_photograph_overlap_and_stay_inside(width: int, height: int) -> None:
    fine, whole = plan_passes(width, height)
    assert fine.gain == 1.0
    assert [(t.left, t.top, t.right, t.bottom) for t in whole.tiles] == [(0, 0, width, height)]
    for low, high, limit in (("left", "right", width), ("top", "bottom", height)):
        spans = sorted({(getattr(tile, low), getattr(tile, high)) for tile in fine.tiles})
        assert spans[0][0] == 0
        assert spans[-1][1] == limit
        assert {end - start for start, end in spans} == {min(416, limit)}
        assert all(before[1] - after[0] >= int(OVERLAP_RATIO * 416) for before, after in itertools.pairwise(spans))


@pytest.mark.parametrize(
    ("wants_mm", "gsd_mm", "gains"),
    [
        ((1.0,), 0.5, [0.5]),
        ((1.0, 3.0), 0.5, [0.5, 0.5 / 3]),
        ((1.0, 1.2), 0.5, [0.5]),  # nearly the same scale: one pass
        ((1.0,), 4.0, [1.25]),  # nothing is enlarged by more than a quarter
        ((1.0,), None, [1.0, 416 / 8000]),
        ((), 0.5, [1.0, 416 / 8000]),
        ((12.0,), 0.5, [416 / 8000]),  # coarser than the whole photograph in one input
    ],
)
def test_scales_follow_the_facade(wants_mm: tuple[float, ...], gsd_mm: float | None, gains: list[float]) -> None:
    found = plan_passes(wants_mm=wants_mm, gsd_mm=gsd_mm)
    assert [tile_pass.gain for tile_pass in found] == pytest.approx(gains, rel=0, abs=1e-9)
    for tile_pass in found[:1]:
        tile = tile_pass.tiles[0]
        assert (tile.right - tile.left) * tile_pass.gain == pytest.approx(416, rel=0, abs=1)  # px of the input


@pytest.mark.parametrize("size", [(832, 832), (416, 300), (100, 60)])
def test_a_photograph_up_to_two_inputs_is_one_tile(size: tuple[int, int]) -> None:
    (whole,) = plan_passes(*size, wants_mm=(1.0,), gsd_mm=1.0)
    assert len(whole.tiles) == 1
    assert (whole.tiles[0].right, whole.tiles[0].bottom) == size


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 79), st.integers(0, 59), st.integers(1, 40), st.integers(1, 40))
def test_tiles_cover_all_of_the_target_and_each_contains_a_part(left: int, top: int, wide: int, high: int) -> None:
    target = np.zeros((60, 80), dtype=bool)
    target[top : top + high, left : left + wide] = True
    target[0, 0] = True  # far from the rest: tiles between are omitted
    tile_pass = plan_tile_passes(
        make_blob_card(416, (1.0,)).input, width_px=8000, height_px=6000, gsd_mm=1.0, target=target
    )[0]
    shown = np.zeros((6000, 8000), dtype=bool)
    large = np.kron(target, np.ones((100, 100), dtype=bool))
    for tile in tile_pass.tiles:
        part = (slice(tile.top, tile.bottom), slice(tile.left, tile.right))
        assert large[part].any()
        shown[part] = True
    assert shown[large].all()


def test_an_empty_target_has_no_pass() -> None:
    target = np.zeros((60, 80), dtype=bool)
    assert plan_tile_passes(make_blob_card(416).input, width_px=8000, height_px=6000, target=target) == ()
