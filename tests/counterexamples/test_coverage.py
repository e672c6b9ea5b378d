"""Coverage of campaigns that say less than they seem to: what the user is told."""

from __future__ import annotations

import logging
import tarfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from facadelake.core.tables import table_from_rows
from facadelake.coverage import CampaignPhotographs, DetectorReach, describe_contradictions, measure_coverage
from facadelake.reporting.page.coverage import describe_coverage
from schemas.vocabulary import SurfaceKind
from tests.counterexamples.command_line import facadelake
from tests.unit.coverage.facade_scene import WALL, look_north, make_building, write_photograph
from tests.unit.lake.small_campaign import commit, rows
from tests.unit.reporting.painted_wall import make_inspection, make_painted_wall

DATA = Path(__file__).parents[1] / "data"
NOT_MEASURED = (
    " has no coverage: it was committed before coverage was measured, or its building has no facades; 'facadelake "
    "inspect' measures it, finished stages are kept"
)
UNKNOWN = (
    "Unknown where the detector's card, or the portfolio for imported boxes, declares no recall by size that reaches "
    "90 % (key recall_by_size; docs/coverage.md)."
)
NOT_LISTED = "Searched is less than imaged: the detector did not process, or the imported file does not list, all."
CONTRADICTION = "): the model, the as-built surface or the positions of these defects are wrong there."
OWN_SURFACE = "The surface is the campaign's own: what no photograph shows is not in it, and is not counted."
NOTHING_KNOWN_BEFORE = "What stands before the walls is unknown, because there is no as-built surface beside the model."


def test_a_campaign_committed_before_schema_5_says_how_to_get_its_coverage(tmp_path: Path) -> None:
    with tarfile.open(DATA / "lake_schema_4.tar.xz") as archive:
        archive.extractall(tmp_path / "lake", filter="data")
    done = facadelake("coverage", "tower", "2026-04", "--lake", tmp_path / "lake")
    assert done.returncode == 1
    assert f"campaign '2026-04' of building 'tower'{NOT_MEASURED}" in done.stderr + done.stdout


def test_unknown_and_not_searched_are_told_beside_the_totals(tmp_path: Path) -> None:
    commit(tmp_path)
    done = facadelake("coverage", "tower", "--lake", tmp_path)
    assert done.returncode == 0, done.stderr
    assert UNKNOWN in done.stdout
    assert NOT_LISTED in done.stdout
    assert "1.0 in no photograph" in done.stdout
    assert "1 area, 1.0 m²" in done.stdout


def test_an_unknown_campaign_is_refused_with_those_there_are(tmp_path: Path) -> None:
    commit(tmp_path)
    done = facadelake("coverage", "tower", "2026-05", "--lake", tmp_path)
    assert done.returncode == 1
    assert "has no campaign '2026-05' of building 'tower'" in done.stderr + done.stdout


def test_a_defect_where_nothing_is_imaged_is_told(tmp_path: Path) -> None:
    """The third defect is put into the fifth cell of the small campaign, which is in no photograph."""
    made = rows()
    made["defects"][2]["x_site_m"] = 1.1
    made["coverage"] = [cell | {"z_site_m": 3.5, "v_min_m": 3.375, "v_max_m": 3.625} for cell in made["coverage"]]
    tables = {name: table_from_rows(name, made[name]) for name in ("coverage", "defects")}
    said = describe_contradictions(tables["coverage"], tables["defects"])
    assert said.startswith("Defects lie where coverage says that no photograph shows the facade (1: defect-0002)")
    assert said.endswith(CONTRADICTION)
    assert describe_contradictions(tables["coverage"].slice(0, 0), tables["defects"]) == ""


def test_a_photograph_that_is_gone_and_a_mask_of_another_size(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_photograph(tmp_path / "a.png")
    cv2.imwrite(str(tmp_path / "mask.png"), np.zeros((80, 100), dtype=np.uint8))
    posed = {"a.png": look_north(4.0, 6.0, 2.0), "gone.png": look_north(4.0, 6.0, 2.0)}
    photographs = CampaignPhotographs(posed=posed, root=tmp_path, masks={"a.png": tmp_path / "mask.png"})
    with caplog.at_level(logging.WARNING):
        table = measure_coverage(
            make_building({"wall": WALL}), photographs, DetectorReach(searched=frozenset()), grazing_above_deg=80.0
        )
    assert "gone.png cannot be read: it shows no part of the facades" in caplog.text
    assert f"mask {tmp_path / 'mask.png'} is 100x80 pixels, its photograph 1000x600" in caplog.text
    assert "; save it in the size of the photograph; the mask is not used" in caplog.text
    assert max(table.column("imaged_count").to_pylist()) == 1


def test_the_report_says_what_the_surface_cannot_show(tmp_path: Path) -> None:
    painted = make_painted_wall(tmp_path)
    photographs = CampaignPhotographs(posed=painted.posed, root=tmp_path)
    coverage = measure_coverage(
        painted.building, photographs, DetectorReach(searched=frozenset()), grazing_above_deg=80.0
    )
    inspection = replace(make_inspection(painted, [], []), coverage=coverage)
    assert NOTHING_KNOWN_BEFORE in describe_coverage(inspection, [], tmp_path)[0].text
    bare = replace(inspection, building=replace(painted.building, surface_kind=SurfaceKind.AS_BUILT))
    text = describe_coverage(bare, [], tmp_path)[0].text
    assert OWN_SURFACE in text.replace("&#x27;", "'")
    assert NOTHING_KNOWN_BEFORE not in text
