"""The whole castle campaign by the command line: 29 real photographs, its model, its boxes, its control points.

The portfolio's own entry, but features are looked for in photographs of a third of the default's size: benchmarks/
measures the default.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from facadelake.lake.read import read_table

pytestmark = [pytest.mark.realdata, pytest.mark.slow]

REGISTRY = Path(__file__).parents[2] / "data" / "portfolio.yaml"
CLI = [sys.executable, "-c", "from cli.main import main; main()"]
KEYS = {
    "photographs", "camera_error_m", "ray_error_m", "observation_error_m", "defect_error_m", "roundtrip_px",
    "roundtrip_cm", "merge", "element_correct_share", "off_truth", "coverage_2sigma",
    "coverage_2sigma_observations", "coverage_2sigma_defects", "roundtrip_defects_px", "roundtrip_defects_cm",
    "element_correct_share_defects",
    "covariance_consistency", "check_points", "table2",
}  # fmt: skip


class Castle:
    """A lake with the castle in it."""

    def __init__(self, data: Path, root: Path) -> None:
        self.lake, self.truth = root / "lake", data / "castle" / "truth"
        entries = yaml.safe_load(REGISTRY.read_text())["buildings"]
        castle = next(entry for entry in entries if entry["id"] == "castle")
        self._registry = root / "portfolio.yaml"
        halved = {**castle, "tolerances": {"features_max_image_px": 1200}}
        self._registry.write_text(yaml.safe_dump({"buildings": [halved]}))
        self._environment = {**os.environ, "FACADELAKE_SHARED_DATA": str(data)}

    def run(self, *words: str) -> str:
        """The command line's output."""
        done = subprocess.run(
            [*CLI, *words, "--portfolio", str(self._registry), "--lake", str(self.lake)],
            capture_output=True,
            text=True,
            env=self._environment,
            timeout=1500,
        )
        assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
        assert "Traceback" not in done.stdout + done.stderr
        return done.stdout

    def inspect(self, *more: str) -> str:
        """Inspect the campaign."""
        return self.run("inspect", "castle", "2026-04", *more)

    def figures(self, *more: str) -> dict[str, Any]:
        """The figures of the latest version against truth."""
        text = self.run("evaluate", "castle", "2026-04", "--truth", str(self.truth), "--json", *more)
        answer: dict[str, Any] = json.loads(text)
        return answer


@pytest.fixture(scope="module")
def castle(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Castle:
    """The campaign inspected with its control points (what ``auto`` chooses)."""
    castle = Castle(shared_data, tmp_path_factory.mktemp("castle"))
    castle.inspect()
    return castle


@pytest.fixture(scope="module")
def exact(castle: Castle) -> dict[str, Any]:
    """The figures with control points and exact boxes."""
    return castle.figures()


def test_every_photograph_is_localised_and_the_figures_have_their_keys(castle: Castle, exact: dict[str, Any]) -> None:
    figures = exact
    assert figures.keys() == KEYS
    assert figures["photographs"] == {"total": 29, "localised": 29}
    passport = read_table(castle.lake, "georeference").to_pylist()[0]
    assert (passport["control"], passport["points_used"]) == ("gcp", 6)
    # A similarity to six control points gave 18 cm and 2.5 cm before the principal point was free (methods.md).
    assert 0.005 < figures["camera_error_m"]["mean"] < 0.12  # m
    assert 0.002 < figures["ray_error_m"]["mean"] < 0.025  # m
    # The ceiling with the published cameras is a mean of 4.4 cm and a median of 2.9 cm: the relief is not in the model.
    assert 0.02 < figures["observation_error_m"]["median"] < 0.05  # m
    assert 0.003 < figures["defect_error_m"]["median"] < 0.04  # m
    assert figures["merge"]["precision"] > 0.97 and figures["merge"]["recall"] > 0.95
    assert figures["element_correct_share"] > 0.93


@pytest.mark.xfail(
    reason="at 1200 px the block is weak along the viewing direction, which no jackknife shows: 0.48 to 0.72 of the "
    "cameras are inside 2 sigma by the choice of its regions, at full size 0.90 (docs/figures.md)"
)
def test_true_errors_of_the_cameras_are_inside_their_sigmas(exact: dict[str, Any]) -> None:
    assert 0.6 <= exact["coverage_2sigma"] <= 1.0


def test_true_errors_of_observations_and_defects_are_inside_their_sigmas(exact: dict[str, Any]) -> None:
    """The weak direction is along the rays: what they meet is not affected."""
    assert exact["coverage_2sigma_observations"] >= 0.9
    assert exact["coverage_2sigma_defects"] >= 0.9


def test_noisy_boxes_cost_accuracy_but_not_the_campaign(castle: Castle, exact: dict[str, Any]) -> None:
    noisy = castle.figures("--detections", "noisy")
    assert noisy["camera_error_m"] == exact["camera_error_m"]
    assert exact["ray_error_m"]["mean"] < noisy["ray_error_m"]["mean"] < 0.05  # m
    assert 0.97 < noisy["merge"]["f1"] <= exact["merge"]["f1"]
    assert noisy["defect_error_m"]["mae"] > 1.5 * exact["defect_error_m"]["mae"]  # too good would be wrong, too
    assert noisy["off_truth"] <= 3
