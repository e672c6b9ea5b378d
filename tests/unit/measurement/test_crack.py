"""Cracks of known width, drawn as a camera would show them, and walls without any."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from benchmarks.drawn_cracks import DrawnCrack, ImageDegradation, draw_crack, draw_wall
from facadelake.measurement.campaign import estimate_photograph_blur, measure_in_photograph
from facadelake.measurement.crack import CrackMeasurement
from schemas.vocabulary import CrackWidthOutcome


def row_of(box: tuple[float, float, float, float], mask: str | None = None) -> dict[str, object]:
    names = ("box_x_px", "box_y_px", "box_width_px", "box_height_px")
    return {**dict(zip(names, box, strict=True)), "mask": mask}


def measured(crack: DrawnCrack, mask: str | None = None) -> CrackMeasurement:
    return measure_in_photograph(crack.image, row_of(crack.box_px, mask), estimate_photograph_blur(crack.image))


def band(line: NDArray[np.float64], width_px: float) -> str:
    """A mask as a person draws it: the line, widened."""
    return str(shapely.to_wkt(shapely.buffer(shapely.linestrings(line), width_px / 2)))


@pytest.mark.parametrize(
    ("width_px", "wall", "off_px"),
    [(2.0, "render", 0.45), (3.0, "render", 0.3), (5.0, "render", 0.3), (5.0, "brick", 0.5), (12.0, "render", 0.4)],
)
def test_width_and_length_of_drawn_cracks(width_px: float, wall: str, off_px: float) -> None:
    errors, pulls = [], []
    for seed in range(3):
        crack = draw_crack(np.random.default_rng(seed), width_px, wall=wall)
        found = measured(crack)
        assert found.outcome is CrackWidthOutcome.MEASURED
        assert found.width is not None
        errors.append(found.width.mean_px - crack.mean_px)
        pulls.append(errors[-1] / found.width.sigma_px)
        assert found.width.largest_px > found.width.mean_px
        assert abs(found.width.largest_px - crack.max_px) < 0.15 * crack.max_px + 0.3  # px
        assert 0.93 < found.length_px / crack.length_px < 1.04
    assert max(map(abs, errors)) < off_px  # px
    assert max(map(abs, errors)) > 1e-4  # px: noise was put in
    assert max(map(abs, pulls)) < 3.0  # sigmas


def test_a_crack_narrower_than_the_blur_has_a_limit_and_no_width() -> None:
    for seed in range(4):
        crack = draw_crack(np.random.default_rng(seed), 0.7)
        found = measured(crack)
        assert found.outcome is CrackWidthOutcome.BELOW_LIMIT
        assert found.width is not None
        assert crack.mean_px < found.width.limit_px < 5.0  # px
        assert found.line_px is not None  # it is seen, only its width is not


@pytest.mark.parametrize("wall", ["render", "brick"])
def test_no_width_is_made_up_for_a_hairline(wall: str) -> None:
    found = [measured(draw_crack(np.random.default_rng(seed), 0.4, wall=wall)).outcome for seed in range(4)]
    assert CrackWidthOutcome.MEASURED not in found


def test_a_mask_leads_to_the_same_width() -> None:
    crack = draw_crack(np.random.default_rng(7), 4.0)
    found = measured(crack, band(crack.line_px, 7.0))  # drawn too wide, as masks are
    assert found.outcome is CrackWidthOutcome.MEASURED
    assert found.width is not None
    assert abs(found.width.mean_px - crack.mean_px) < 0.3  # px
    assert 0.93 < found.length_px / crack.length_px < 1.06


def test_the_line_lies_on_the_crack() -> None:
    crack = draw_crack(np.random.default_rng(3), 3.0)
    found = measured(crack)
    apart = shapely.distance(shapely.points(found.line_px), shapely.linestrings(crack.line_px))
    assert float(np.median(apart)) < 0.25  # px
    assert float(np.max(apart)) < 1.5  # px


def test_a_wall_without_a_crack_has_no_line() -> None:
    outcomes = []
    for seed in range(8):
        image = draw_wall(np.random.default_rng(seed), 200)
        outcomes.append(
            measure_in_photograph(image, row_of((40, 40, 120, 60)), estimate_photograph_blur(image)).outcome
        )
    assert outcomes.count(CrackWidthOutcome.NO_LINE) >= 7


def test_a_filled_crack_brighter_than_the_wall_is_not_measured() -> None:
    found = measured(draw_crack(np.random.default_rng(1), 4.0, darkness=-0.6))
    assert found.outcome is not CrackWidthOutcome.MEASURED


def test_a_blurred_photograph_tells_less() -> None:
    sharp = measured(draw_crack(np.random.default_rng(5), 3.0, degradation=ImageDegradation(blur_px=0.5)))
    soft = measured(draw_crack(np.random.default_rng(5), 3.0, degradation=ImageDegradation(blur_px=2.5)))
    assert sharp.width is not None
    assert soft.width is not None
    assert soft.width.blur_px > sharp.width.blur_px + 1.0  # px
    assert soft.width.limit_px > sharp.width.limit_px


@pytest.mark.parametrize(("level", "expected"), [(0, "no_line"), (128, "no_line"), (255, "no_line")])
def test_a_plain_picture_has_no_line(level: int, expected: str) -> None:
    image = np.full((120, 160, 3), level, dtype=np.uint8)
    for box in ((10, 10, 100, 60), (-5, -5, 12, 8), (150, 110, 40, 40), (20, 20, 0.5, 0.5)):
        assert measure_in_photograph(image, row_of(box), estimate_photograph_blur(image)).outcome == expected


def test_a_bar_of_whole_pixels_has_their_width() -> None:
    image = np.full((200, 300, 3), 200, dtype=np.uint8)
    image[95:105] = 20
    found = measure_in_photograph(image, row_of((20, 60, 260, 80)), estimate_photograph_blur(image))
    assert found.width is not None
    assert abs(found.width.mean_px - 10.0) < 0.1  # px
    assert found.line_px is not None
    np.testing.assert_allclose(found.line_px[:, 1], 100.0, rtol=0, atol=0.1)  # px: rows 95 to 104 end at 105.0


def test_one_edge_alone_is_no_line() -> None:
    image = np.full((200, 300, 3), 200, dtype=np.uint8)
    image[:, 150:] = 20
    assert (
        measure_in_photograph(image, row_of((100, 20, 100, 160)), estimate_photograph_blur(image)).outcome == "no_line"
    )
