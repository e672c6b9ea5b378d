"""Cracks in odd places of odd photographs: each has an outcome, none stops the others, and no width is made up."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from facadelake.core.tables import table_from_rows
from facadelake.measurement.campaign import measure_detections

Sides = tuple[float, float, float, float]


def row(number: int, photo: str, sides: Sides, mask: str | None = None) -> dict[str, Any]:
    x, y, width, height = sides
    return {
        "detection_id": f"{photo}#{number}", "photo_id": photo, "detection_outcome": "accepted",
        "defect_class": "crack", "source_class": "crack", "score": 0.9, "mask": mask,
        "box_x_px": x, "box_y_px": y, "box_width_px": width, "box_height_px": height,
        "detector": "onnx:m", "detector_sha256": "0" * 64,
    }  # fmt: skip


def measured(root: Path, *rows: dict[str, Any]) -> list[dict[str, Any]]:
    return list(measure_detections(table_from_rows("detections", list(rows)), root).to_pylist())


@pytest.fixture
def wall(tmp_path: Path) -> Path:
    """A bare wall of 120 x 90 px: there is nothing to be measured in it."""
    noise = np.random.default_rng(1).normal(150, 4, (90, 120))
    Image.fromarray(np.clip(noise, 0, 255).astype(np.uint8)).convert("RGB").save(tmp_path / "wall.png")
    Image.new("RGB", (1, 1), (90, 90, 90)).save(tmp_path / "pixel.png")
    Image.new("L", (120, 1), 90).save(tmp_path / "row.png")
    (tmp_path / "torn.jpg").write_bytes(b"\xff\xd8\xff torn")
    return tmp_path


PLACES: dict[str, tuple[str, Sides, str | None]] = {
    "a corner": ("wall.png", (0.0, 0.0, 1.0, 1.0), None),
    "the last pixel": ("wall.png", (119.5, 89.5, 0.5, 0.5), None),
    "the whole": ("wall.png", (0.0, 0.0, 120.0, 90.0), None),
    "an empty mask": ("wall.png", (10.0, 10.0, 40.0, 20.0), "POLYGON EMPTY"),
    "a mask beside the photograph": (
        "wall.png", (10.0, 10.0, 40.0, 20.0), "POLYGON ((900 900, 910 900, 910 910, 900 910, 900 900))"
    ),
    "a mask that crosses itself": (
        "wall.png", (10.0, 10.0, 40.0, 20.0), "POLYGON ((10 10, 50 30, 50 10, 10 30, 10 10))"
    ),
    "a photograph of a pixel": ("pixel.png", (0.0, 0.0, 1.0, 1.0), None),
    "a photograph of a row": ("row.png", (0.0, 0.0, 120.0, 1.0), None),
}  # fmt: skip


def test_cracks_in_odd_places_have_an_outcome_and_no_width(wall: Path) -> None:
    rows = [row(i, photo, sides, mask) for i, (photo, sides, mask) in enumerate(PLACES.values())]
    found = measured(
        wall, *rows, row(99, "torn.jpg", (0.0, 0.0, 10.0, 10.0)), row(98, "gone.jpg", (0.0, 0.0, 5.0, 5.0))
    )
    assert len(found) == len(rows) + 2
    outcomes = {one["photo_id"]: one["crack_width_outcome"] for one in found}
    assert (outcomes["torn.jpg"], outcomes["gone.jpg"]) == ("not_readable", "not_readable")
    for name, one in zip(PLACES, found, strict=False):
        assert one["crack_width_outcome"] in ("no_line", "below_limit"), name
        assert one["crack_width_px"] is None, name
        for column in ("crack_width_limit_px", "crack_length_px"):
            assert one[column] is None or (math.isfinite(one[column]) and one[column] >= 0), name


def test_a_width_that_a_person_stated_stays_in_a_photograph_that_cannot_be_read(wall: Path) -> None:
    stated = {**row(1, "torn.jpg", (0.0, 0.0, 10.0, 10.0)), "crack_width_px": 3.5}
    (found,) = measured(wall, stated)
    assert (found["crack_width_px"], found["crack_width_outcome"]) == (3.5, "stated")


@pytest.mark.parametrize("kind", ["grey", "16 bit", "CMYK"])
def test_a_bar_has_its_width_however_it_is_stored(tmp_path: Path, kind: str) -> None:
    """A dark bar of 6 px across a wall."""
    pixels = np.full((160, 240), 190, dtype=np.uint8)
    pixels[70:76, 20:220] = 30
    image = {
        "grey": lambda: Image.fromarray(pixels),
        "16 bit": lambda: Image.fromarray(pixels.astype(np.uint16) * 257),
        "CMYK": lambda: Image.fromarray(np.repeat(pixels[..., None], 3, axis=2)).convert("CMYK"),
    }[kind]()
    image.save(tmp_path / "bar.tif")
    (found,) = measured(tmp_path, row(1, "bar.tif", (18.0, 64.0, 204.0, 18.0)))
    assert found["crack_width_outcome"] == "measured"
    assert found["crack_width_px"] == pytest.approx(6.0, rel=0, abs=0.5)  # px
    assert found["crack_length_px"] == pytest.approx(200.0, rel=0, abs=12.0)  # px


def test_a_large_mask_of_two_parts_in_a_photograph_of_odd_sides_is_one_line(tmp_path: Path) -> None:
    """So large that its way is searched by blocks of pixels, which do not divide the photograph."""
    pixels = np.random.default_rng(3).normal(180, 3, (401, 703)).clip(0, 255).astype(np.uint8)
    pixels[198:204, 50:650] = 20
    Image.fromarray(pixels).save(tmp_path / "wall.png")
    parts = "((50 195, 250 195, 250 207, 50 207, 50 195)), ((450 195, 650 195, 650 207, 450 207, 450 195))"
    (crack,) = measured(tmp_path, row(1, "wall.png", (0.0, 0.0, 703.0, 401.0), f"MULTIPOLYGON ({parts})"))
    assert crack["crack_width_outcome"] == "measured"
    assert crack["crack_width_px"] == pytest.approx(6.0, rel=0, abs=0.6)  # px
    assert crack["crack_length_px"] == pytest.approx(600.0, rel=0, abs=40.0)  # px, over the gap
