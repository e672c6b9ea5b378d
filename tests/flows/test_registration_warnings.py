"""Detections beside the building: a warning where they are many, since model or poses may be wrong."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from facadelake.registry import Building
from tasks.job import InspectionJob, StageResult
from tasks.register import list_registration_warnings


def warn(model: str, **counts: int) -> list[str]:
    building = Building.model_validate(
        {"id": "barn", "name": "Barn", "model": model, "photographs": "images", "campaigns": ["2026-04"]}
    )
    job = InspectionJob(
        building=building, campaign_id="2026-04", run_id="r", started_at=datetime.now(UTC), code_sha256="0" * 64,
        lake=Path("lake"), control=None, detections=None, poses=None,
    )  # fmt: skip
    registered = StageResult(
        stage="register", key="k", folder=Path("folder"), content_sha256="0", hit=False, seconds=0.0, peak_mib=0.0,
        counts=tuple(counts.items()),
    )  # fmt: skip
    return list_registration_warnings(job, registered)


def test_a_mesh_that_is_mirrored_is_told_by_its_detections() -> None:
    """A mesh with y up, read with z up: 7 of 110 detections met it, and the campaign was committed without a word."""
    (warning,) = warn("barn.obj", off_target=103, registered=7)
    assert warning.startswith(
        "103 of 110 detections (94%, limit 33%) are not on the building: the model may be another, turned or mirrored "
        "(crs.axes and crs.unit of the mesh), the poses may be wrong, or the detector finds much beside the building; "
    )
    assert "of the mesh" not in warn("barn.ifc", off_target=39, registered=69, grazing=2)[0]


@pytest.mark.parametrize(
    "counts",
    [
        {"off_target": 6, "registered": 346},
        {"off_target": 9},
        {"off_target": 30, "registered": 65},
        {"off_target": 3, "registered": 7, "unlocalised": 90},
        {"unlocalised": 90},
    ],
)
def test_few_detections_beside_the_building_are_no_warning(counts: dict[str, int]) -> None:
    assert warn("barn.obj", **counts) == []
