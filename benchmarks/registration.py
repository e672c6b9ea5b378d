"""Accuracy of registration against truth: with published cameras imported as poses, and with reconstructed ones.

    .venv/bin/python -m benchmarks.registration imported --work FOLDER      # a minute: no reconstruction, no lake
    .venv/bin/python -m benchmarks.registration castle demo --work FOLDER   # whole inspections; reuses FOLDER

``imported`` writes the published cameras of castle and demo as poses and imports them, without noise and with noise of
2 cm and 0.05 deg that the file states; it measures registration and deduplication alone. ``castle`` and ``demo`` run
whole inspections by the command line, with control by surveyed points and by the model, and exact and noisy boxes.
Prints Markdown.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pyarrow as pa

from benchmarks.foundation import DEMO, ROOT, SHARED, evaluate_campaign, run_facadelake
from benchmarks.published_poses import write_published_poses
from benchmarks.registration_report import RegistrationReport
from facadelake.building import BuildingModel, read_registered_model
from facadelake.building.surface import Surface, build_horizontal_distance
from facadelake.campaigns import register_on_committed_poses
from facadelake.detection.coco import import_coco
from facadelake.evaluation.campaigns import compute_figures
from facadelake.evaluation.campaigns.comparison import compare_with_truth
from facadelake.georeferencing import SiteFrame
from facadelake.georeferencing.gcp import read_surveyed_points
from facadelake.georeferencing.imported import place_imported_poses, read_poses
from facadelake.georeferencing.imported.placement import ImportedPlacement
from facadelake.photos import ingest_photographs
from facadelake.registry import Building, read_portfolio

SEED = 4


@dataclass(frozen=True, kw_only=True)
class BenchmarkCampaign:
    """A campaign with truth, and what its registration needs."""

    name: str
    building: Building
    campaign_id: str
    model: BuildingModel
    surface: Surface
    photos: pa.Table
    truth: Path


def _read_campaign(building_id: str, campaign_id: str, truth: Path, name: str) -> BenchmarkCampaign:
    building = read_portfolio(ROOT / "data" / "portfolio.yaml").get_building(building_id)
    model = read_registered_model(building)
    photos = ingest_photographs(
        building.locate_photographs(campaign_id),
        distance_to_model_m=build_horizontal_distance(model),
        close_range_below_m=8.0,
    )
    return BenchmarkCampaign(
        name=name, building=building, campaign_id=campaign_id, model=model, surface=Surface(model), photos=photos,
        truth=truth,
    )  # fmt: skip


def _register(campaign: BenchmarkCampaign, placed: ImportedPlacement, boxes: str) -> dict[str, Any]:
    """Register and deduplicate one file of detections on imported poses; figures against truth."""
    found = import_coco(
        campaign.building.locate_detections(campaign.campaign_id, boxes), campaign.photos, class_names={}
    )
    tables = {"poses": placed.poses, "georeference": placed.georeference}
    merged = register_on_committed_poses(campaign.building, campaign.campaign_id, campaign.model, found, tables)
    return compute_figures(
        compare_with_truth(
            photos=campaign.photos,
            poses=placed.poses,
            detections=found,
            observations=merged.observations,
            defects=merged.defects,
            truth=campaign.truth,
            origin=campaign.model.origin,
            map_crs=campaign.model.map_crs,
        )
    ).convert_to_json()


def measure_imported(report: RegistrationReport, work: Path) -> None:
    """Measure registration on imported poses; ``work`` is the folder for the files of poses."""
    for campaign in _read_campaigns():
        site_frame = SiteFrame(
            origin=campaign.model.origin,
            map_crs=campaign.model.map_crs,
            vertical_datum=campaign.model.vertical_datum,
            georeference_level=campaign.model.georeference_level,
        )
        control = campaign.building.locate_control_points(campaign.campaign_id)
        surveyed = [read_surveyed_points(control)] if control else []
        for description, noise, files in (
            ("published cameras", None, ("exact", "noisy")),
            ("published cameras with noise", np.random.default_rng(SEED), ("exact",)),
        ):
            begin = time.perf_counter()
            path = write_published_poses(
                campaign.truth, work / f"{campaign.name} {description}.csv".replace(" ", "-"), noise=noise
            )
            placed = place_imported_poses(
                read_poses(path),
                campaign.photos,
                site_frame=site_frame,
                surface=campaign.surface,
                placement_sigma_max_m=0.5,
                surveyed=surveyed,
            )
            for boxes in files:
                figures = _register(campaign, placed, boxes)
                report.add(f"{campaign.name}, {description}, {boxes} boxes", figures, time.perf_counter() - begin)
                begin = time.perf_counter()


def _read_campaigns() -> Iterator[BenchmarkCampaign]:
    """The campaigns of castle and demo that exist on this machine."""
    if (SHARED / "castle").is_dir():
        yield _read_campaign("castle", "2026-04", SHARED / "castle" / "truth", "castle")
    for campaign in ("2026-04", "2026-10"):
        truth = DEMO / "campaigns" / campaign / "truth"
        if truth.is_dir():
            yield _read_campaign("demo", campaign, truth, f"demo {campaign}")


def _inspect(
    report: RegistrationReport, lake: Path, building: str, campaign: str, control: str, truth: Path, name: str
) -> None:
    begin = time.perf_counter()
    run_facadelake("inspect", building, campaign, "--georeference", control, "--lake", str(lake))
    exact = evaluate_campaign(lake, building, campaign, truth)
    report.add(f"{name}, {control}, exact boxes", exact, time.perf_counter() - begin)
    begin = time.perf_counter()
    noisy = evaluate_campaign(lake, building, campaign, truth, "--detections", "noisy")
    report.add(f"{name}, {control}, noisy boxes", noisy, time.perf_counter() - begin)


def measure_castle(report: RegistrationReport, work: Path) -> None:
    """Inspect the castle with control points and with its model as control, in one lake with one reconstruction."""
    for control in ("gcp", "model"):
        _inspect(report, work / "castle", "castle", "2026-04", control, SHARED / "castle" / "truth", "castle")


def measure_demo(report: RegistrationReport, work: Path) -> None:
    """Inspect two campaigns of the demo with control points, and 2026-04 with its model as control."""
    if not DEMO.is_dir():
        run_facadelake("demo", "--lake", str(work / "demo"))
    for campaign, control in (("2026-04", "gcp"), ("2026-10", "gcp"), ("2026-04", "model")):
        truth = DEMO / "campaigns" / campaign / "truth"
        _inspect(report, work / "demo", "demo", campaign, control, truth, f"demo {campaign}")


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="+", choices=["imported", "castle", "demo"])
    parser.add_argument("--work", type=Path, help="Folder for lakes and poses; existing lakes are reused.")
    parser.add_argument("--json", type=Path, help="Also write all figures to this file.")
    arguments = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    print(
        f"{datetime.now(UTC):%Y-%m-%d}, {psutil.cpu_count()} cores, {psutil.virtual_memory().total / 2**30:.0f} GiB, "
        f"Python {platform.python_version()}"
    )
    report = RegistrationReport()
    with tempfile.TemporaryDirectory() as scratch:
        work = arguments.work or Path(scratch)
        work.mkdir(parents=True, exist_ok=True)
        for part in arguments.parts:
            {"imported": measure_imported, "castle": measure_castle, "demo": measure_demo}[part](report, work)
    report.print_goals()
    if arguments.json:
        arguments.json.write_text(json.dumps(report.figures, indent=1))


if __name__ == "__main__":
    main()
