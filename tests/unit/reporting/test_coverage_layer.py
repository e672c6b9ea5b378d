"""The coverage layer of an elevation and the report's section on coverage."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pytest

from facadelake.coverage import CampaignPhotographs, DetectorReach, measure_coverage
from facadelake.reporting.elevations.coverage_figure import select_coverage
from facadelake.reporting.elevations.elevation import draw_elevations
from facadelake.reporting.elevations.facades import Facade
from facadelake.reporting.inspection import PictureSettings
from facadelake.reporting.page.coverage import describe_coverage
from tests.unit.reporting.painted_wall import PaintedWall, make_inspection

COARSE = PictureSettings(cell_m=0.03)


@pytest.fixture(scope="module")
def reach() -> DetectorReach:
    return DetectorReach(searched=frozenset({"a.png", "b.png"}), crack_width_px=3.0, patch_px=20.0)


def measure(painted: PaintedWall, reach: DetectorReach) -> pa.Table:
    """Coverage by a.png alone, which shows the western part of the wall."""
    photographs = CampaignPhotographs(posed={"a.png": painted.posed["a.png"]}, root=painted.root)
    return measure_coverage(painted.building, photographs, reach, grazing_above_deg=80.0)


def make_view(**others: float) -> Facade:
    extents = {"u_min_m": -0.5, "u_max_m": 8.5, "v_min_m": -0.3, "v_max_m": 4.3, "near_w_m": 2.5, "far_w_m": -0.3}
    return Facade(code="S", part=0, azimuth_deg=180.0, area_m2=32.0, **{**extents, **others})


def test_the_layer_has_the_cells_of_its_facade_and_depth(painted: PaintedWall, reach: DetectorReach) -> None:
    coverage = measure(painted, reach)
    cells = select_coverage(coverage, make_view())
    assert len(cells) == 512
    assert cells.is_crack_width
    assert (cells.corners_uv_m.min(), cells.corners_uv_m.max()) == (0.0, 8.0)
    assert len(select_coverage(coverage, make_view(near_w_m=-1.0, far_w_m=-5.0))) == 0


def test_without_a_recall_the_layer_shows_the_pixel(painted: PaintedWall, reach: DetectorReach) -> None:
    cells = select_coverage(measure(painted, replace(reach, crack_width_px=None)), make_view())
    assert not cells.is_crack_width
    assert 5.0 < np.nanmin(cells.value_mm) < 8.0  # mm: 5.5 m at 900 px


def test_a_sheet_is_drawn_beside_each_elevation(painted: PaintedWall, reach: DetectorReach, tmp_path: Path) -> None:
    coverage = measure(painted, reach)
    inspection = replace(make_inspection(painted, [], []), coverage=coverage)
    (elevation,) = draw_elevations(inspection, painted.surface, tmp_path, COARSE)
    assert elevation.coverage_path == tmp_path / "coverage_S.png"
    sheet = cv2.imread(str(elevation.coverage_path))
    assert sheet.shape[1] > 900
    # The east of the wall is in no photograph: the red of that is in the sheet.
    assert "not_in_view" in coverage.column("coverage_outcome").to_pylist()
    red = (sheet[..., 2] > 150) & (sheet[..., 1] < 80) & (sheet[..., 0] < 90)
    assert red.any()


def test_the_section_tells_what_was_not_imaged_and_what_is_unknown(
    painted: PaintedWall, reach: DetectorReach, tmp_path: Path
) -> None:
    coverage = measure(painted, replace(reach, crack_width_px=None))
    inspection = replace(make_inspection(painted, [], []), coverage=coverage)
    text = "".join(part.text for part in describe_coverage(inspection, [], tmp_path))
    assert "of 32 m² of walls and openings" in text
    assert "recall_by_size" in text
    assert "unknown" in text
    assert "in no photograph" in text
    assert "there is no as-built surface beside the model" in text
    assert "Ground &lt;floor&gt;" in text


def test_a_campaign_without_coverage_says_so(painted: PaintedWall, tmp_path: Path) -> None:
    (part,) = describe_coverage(make_inspection(painted, [], []), [], tmp_path)
    assert "was not measured" in part.text
