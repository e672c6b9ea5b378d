"""COCO masks, as polygons and as run lengths, become outlines in pixels; where a mask is invalid, its box is used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from facadelake.detection.boxes import Box
from facadelake.detection.coco.mask import fit_mask, shape_from_segmentation
from tests.unit.detection.test_import_detections import HEIGHT, WIDTH, import_rows, write_coco_file

SLANTING = [100, 100, 200, 190, 200, 200, 100, 110]  # a crack 10 px high, 100 px long


def encode_run_lengths(pixels: NDArray[np.bool_]) -> list[int]:
    """Column-major run lengths, starting with background; computed pixel by pixel, not by cumulative sums."""
    runs, value, length = [], False, 0
    for pixel in pixels.T.ravel().tolist():
        if pixel != value:
            runs.append(length)
            value, length = pixel, 0
        length += 1
    return [*runs, length]


def compress_run_lengths(runs: list[int]) -> str:
    """rleToString of cocoapi, after maskApi.c."""
    text = ""
    for i, run in enumerate(runs):
        x = run - runs[i - 2] if i > 2 else run
        more = True
        while more:
            bits = x & 0x1F
            x >>= 5
            more = x != -1 if bits & 0x10 else x != 0
            text += chr((bits | 0x20 if more else bits) + 48)
    return text


def draw_blob() -> NDArray[np.bool_]:
    """A disc with a hole, and a bar that continues from the photograph's bottom to the top of the next column."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    away = np.hypot(x - 150, y - 100)
    pixels = (away < 40) & (away > 15)
    pixels[400:, 300] = True
    pixels[:30, 301] = True
    return pixels


def test_a_polygon_and_its_crack_width_are_unchanged(tmp_path: Path) -> None:
    path = write_coco_file(
        tmp_path,
        {"bbox": [100, 100, 100, 100], "segmentation": [SLANTING], "attributes": {"crack_width_px": 2.5}},
        {"bbox": [100, 100, 100, 100], "segmentation": [SLANTING], "crack_width_px": 4},
    )
    first, second = import_rows(path)
    mask = shapely.from_wkt(first["mask"])
    assert mask.normalize().equals_exact(shapely.Polygon(np.reshape(SLANTING, (4, 2))).normalize(), tolerance=0.01)
    assert (first["crack_width_px"], second["crack_width_px"]) == (2.5, 4.0)
    assert first["reason"] is None


def test_run_lengths_plain_and_compressed_are_one_mask_of_whole_pixels(tmp_path: Path) -> None:
    pixels = draw_blob()
    runs = encode_run_lengths(pixels)
    box = {"bbox": [0, 0, WIDTH, HEIGHT]}
    plain, packed = import_rows(
        write_coco_file(
            tmp_path,
            {**box, "segmentation": {"counts": runs, "size": [HEIGHT, WIDTH]}},
            {**box, "segmentation": {"counts": compress_run_lengths(runs), "size": [HEIGHT, WIDTH]}},
        )
    )
    assert plain["mask"] == packed["mask"]
    mask = shapely.from_wkt(plain["mask"])
    rows, columns = np.nonzero(np.ones_like(pixels))
    inside = shapely.contains_xy(mask, columns + 0.5, rows + 0.5).reshape(pixels.shape)
    # Outlines are simplified by half a pixel: only pixels along them may differ.
    assert (inside != pixels).sum() < 0.02 * pixels.sum()
    np.testing.assert_allclose(mask.area, pixels.sum(), rtol=0, atol=0.01 * pixels.sum())  # px2
    assert not inside[100, 150]  # the hole
    assert inside[470, 300] and inside[10, 301] and not inside[470, 301]


def test_several_polygons_are_one_mask_and_crossing_rings_are_repaired() -> None:
    whole = Box(x_px=0, y_px=0, width_px=100, height_px=100)
    squares = [[10, 10, 20, 10, 20, 20, 10, 20], [50, 50, 60, 50, 60, 60, 50, 60]]
    two = fit_mask(shape_from_segmentation(squares, WIDTH, HEIGHT)[0], whole).outline
    assert (two.geom_type, two.area) == ("MultiPolygon", 200.0)
    bow = fit_mask(shape_from_segmentation([[0, 0, 40, 40, 40, 0, 0, 40]], WIDTH, HEIGHT)[0], whole).outline
    assert bow.is_valid
    np.testing.assert_allclose(bow.area, 800.0, rtol=0, atol=1e-6)  # px2


def test_a_mask_is_clipped_to_the_photograph_with_its_box(tmp_path: Path) -> None:
    row = import_rows(
        write_coco_file(tmp_path, {"bbox": [-20, 10, 60, 40], "segmentation": [[-20, 10, 40, 10, 40, 50]]})
    )[0]
    assert shapely.from_wkt(row["mask"]).bounds[0] == 0.0
    assert "extends beyond" in row["reason"]


def test_a_mask_without_box_has_its_bounding_box(tmp_path: Path) -> None:
    row = import_rows(write_coco_file(tmp_path, {"segmentation": [SLANTING]}))[0]
    assert row["detection_outcome"] == "accepted"
    assert [row[f"box_{name}_px"] for name in ("x", "y", "width", "height")] == [100, 100, 100, 100]
    assert import_rows(write_coco_file(tmp_path, {"segmentation": []}))[0]["detection_outcome"] == "bad_box"


@pytest.mark.parametrize("segmentation", [None, [], {}, [[100, 100, 200, 100, 200, 200, 100, 200]]])
def test_no_mask_or_one_equal_to_its_box_leaves_the_box_without_a_reason(tmp_path: Path, segmentation: Any) -> None:
    row = import_rows(write_coco_file(tmp_path, {"bbox": [100, 100, 100, 100], "segmentation": segmentation}))[0]
    assert (row["detection_outcome"], row["mask"], row["reason"]) == ("accepted", None, None)


@pytest.mark.parametrize(
    ("segmentation", "reason"),
    [
        ([[1, 2, 3, 4]], "polygon 0 is not 3 or more points"),
        ([[1, 2, 3, 4, 5, None]], "polygon 0 is not 3 or more points"),
        ([[1, 1, 2, 2, 3, 3]], "have no area"),
        ("nonsense", "it is a str"),
        ({"counts": [5], "size": [1]}, "size is [1]"),
        ({"counts": [HEIGHT * WIDTH], "size": [WIDTH, HEIGHT]}, f"are of {HEIGHT} x {WIDTH} px"),
        ({"counts": [1, 2], "size": [HEIGHT, WIDTH]}, "add up to 3"),
        ({"counts": [-1, 2], "size": [HEIGHT, WIDTH]}, "run lengths of 0 or more"),
        ({"counts": [HEIGHT * WIDTH], "size": [HEIGHT, WIDTH]}, "contain no pixel"),
        ({"counts": "\u00e9", "size": [HEIGHT, WIDTH]}, "counts contains"),
        ({"counts": "o", "size": [HEIGHT, WIDTH]}, "ends within a run"),
        ([[300, 300, 320, 300, 320, 320]], "lies outside its box"),
    ],
)
def test_an_unusable_mask_leaves_the_box_with_the_reason(tmp_path: Path, segmentation: Any, reason: str) -> None:
    row = import_rows(write_coco_file(tmp_path, {"bbox": [100, 100, 100, 100], "segmentation": segmentation}))[0]
    assert (row["detection_outcome"], row["mask"]) == ("accepted", None)
    assert reason in row["reason"]
    assert "its box is used instead" in row["reason"]


@pytest.mark.parametrize("width", [-1, "wide", True, float("inf")])
def test_an_invalid_crack_width_is_ignored(tmp_path: Path, width: Any) -> None:
    path = write_coco_file(tmp_path, {"bbox": [100, 100, 100, 100], "crack_width_px": width})
    row = import_rows(path)[0]
    assert (row["detection_outcome"], row["crack_width_px"]) == ("accepted", None)
    assert "crack_width_px is" in row["reason"]
