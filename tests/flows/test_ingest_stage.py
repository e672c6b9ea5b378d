"""The stage that reads the photographs: made anew when what says their positions changes."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from facadelake.core.tables import read_table
from facadelake.registry import Building
from tasks.ingest import ingest
from tasks.job import InspectionJob
from tests.unit.photos.small_photographs import photograph

HEADER = "name,latitude,longitude,ellipsoidal height,sigma_horizontal_m,sigma_vertical_m\n"


def test_another_positions_file_makes_the_photographs_anew(tmp_path: Path) -> None:
    images = tmp_path / "images"
    images.mkdir()
    (images / "a.jpg").write_bytes(photograph(lat=48.94053, lon=8.4078))
    path = tmp_path / "ppk.csv"

    def make_job(positions: object) -> InspectionJob:
        building = Building.model_validate(
            {
                "id": "barn", "name": "Barn", "model": "barn.ifc", "photographs": str(images),
                "campaigns": ["2026-04"], "positions": positions,
            }
        )  # fmt: skip
        return InspectionJob(
            building=building,
            campaign_id="2026-04",
            run_id="r",
            started_at=datetime.now(UTC),
            code_sha256="0" * 64,
            lake=tmp_path / "lake",
            control=None,
            detections=None,
            poses=None,
        )

    def read(job: InspectionJob) -> tuple[bool, str, float]:
        result = ingest.fn(job, None)
        (row,) = read_table("photos", result.folder).to_pylist()
        return result.hit, row["prior_source"], row["prior_lat_deg"]

    path.write_text(HEADER + "a.jpg,48.940512345,8.407812345,180.5,0.011,0.02\n")
    job = make_job({"file": str(path)})
    assert read(job) == (False, "file", 48.940512345)
    assert read(replace(job, run_id="s")) == (True, "file", 48.940512345)
    path.write_text(HEADER + "a.jpg,48.940512346,8.407812345,180.5,0.011,0.02\n")
    assert read(job) == (False, "file", 48.940512346)
    assert read(make_job("exif"))[:2] == (False, "exif")
    assert read(make_job(None))[:2] == (False, "exif")
