"""Measure registration against truth: with published cameras imported as poses, and with the run's own.

    .venv/bin/python -m benchmarks.registration imported --work FOLDER      # a minute: no reconstruction, no lake
    .venv/bin/python -m benchmarks.registration castle demo --work FOLDER   # whole inspections; what FOLDER has is used

``imported`` writes the published cameras of castle and demo as poses.csv and imports them, as they are and with an
error of 2 cm and 0.05 deg that the file states: registration and merging alone. ``castle`` and ``demo`` inspect by
command line, control points and model, exact and noisy boxes. Prints Markdown; no figure is asserted.
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

from benchmarks.foundation import DEMO, ROOT, SHARED, evaluated, facadelake
from benchmarks.published_poses import write_published
from benchmarks.registration_report import Report
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
class Scenery:
    """A campaign with truth, read once."""

    name: str
    building: Building
    campaign_id: str
    model: BuildingModel
    surface: Surface
    photos: pa.Table
    truth: Path


def _scenery(building_id: str, campaign_id: str, truth: Path, name: str) -> Scenery:
    building = read_portfolio(ROOT / "data" / "portfolio.yaml").get_building(building_id)
    model = read_registered_model(building)
    photos = ingest_photographs(
        building.locate_photographs(campaign_id),
        distance_to_model_m=build_horizontal_distance(model),
        close_range_below_m=8.0,
    )
    return Scenery(
        name=name, building=building, campaign_id=campaign_id, model=model, surface=Surface(model), photos=photos,
        truth=truth,
    )  # fmt: skip


def _registered(scene: Scenery, placed: ImportedPlacement, boxes: str) -> dict[str, Any]:
    """The figures of one detections file on imported poses, by the domain's own calls."""
    found = import_coco(scene.building.locate_detections(scene.campaign_id, boxes), scene.photos, class_names={})
    tables = {"poses": placed.poses, "georeference": placed.georeference}
    merged = register_on_committed_poses(scene.building, scene.campaign_id, scene.model, found, tables)
    return compute_figures(
        compare_with_truth(
            photos=scene.photos,
            poses=placed.poses,
            detections=found,
            observations=merged.observations,
            defects=merged.defects,
            truth=scene.truth,
            origin=scene.model.origin,
            map_crs=scene.model.map_crs,
        )
    ).convert_to_json()


def imported(report: Report, work: Path) -> None:
    """Registration alone."""
    for scene in _sceneries():
        site_frame = SiteFrame(
            origin=scene.model.origin,
            map_crs=scene.model.map_crs,
            vertical_datum=scene.model.vertical_datum,
            georeference_level=scene.model.georeference_level,
        )
        control = scene.building.locate_control_points(scene.campaign_id)
        surveyed = [read_surveyed_points(control)] if control else []
        for words, noise, files in (
            ("published cameras", None, ("exact", "noisy")),
            ("published cameras with noise", np.random.default_rng(SEED), ("exact",)),
        ):
            begin = time.perf_counter()
            path = write_published(scene.truth, work / f"{scene.name} {words}.csv".replace(" ", "-"), noise=noise)
            placed = place_imported_poses(
                read_poses(path),
                scene.photos,
                site_frame=site_frame,
                surface=scene.surface,
                placement_sigma_max_m=0.5,
                surveyed=surveyed,
            )
            for boxes in files:
                figures = _registered(scene, placed, boxes)
                report.add(f"{scene.name}, {words}, {boxes} boxes", figures, time.perf_counter() - begin)
                begin = time.perf_counter()


def _sceneries() -> Iterator[Scenery]:
    """The castle and the demo's campaigns, those of them that are there."""
    if (SHARED / "castle").is_dir():
        yield _scenery("castle", "2026-04", SHARED / "castle" / "truth", "castle")
    for campaign in ("2026-04", "2026-10"):
        truth = DEMO / "campaigns" / campaign / "truth"
        if truth.is_dir():
            yield _scenery("demo", campaign, truth, f"demo {campaign}")


def _inspected(report: Report, lake: Path, building: str, campaign: str, control: str, truth: Path, name: str) -> None:
    begin = time.perf_counter()
    facadelake("inspect", building, campaign, "--georeference", control, "--lake", str(lake))
    exact = evaluated(lake, building, campaign, truth)
    report.add(f"{name}, {control}, exact boxes", exact, time.perf_counter() - begin)
    begin = time.perf_counter()
    noisy = evaluated(lake, building, campaign, truth, "--detections", "noisy")
    report.add(f"{name}, {control}, noisy boxes", noisy, time.perf_counter() - begin)


def castle(report: Report, work: Path) -> None:
    """The castle by control points and by its model; one lake, so that the reconstruction is made once."""
    for control in ("gcp", "model"):
        _inspected(report, work / "castle", "castle", "2026-04", control, SHARED / "castle" / "truth", "castle")


def demo(report: Report, work: Path) -> None:
    """Both campaigns of the demo by their control points, and the first by its model."""
    if not DEMO.is_dir():
        facadelake("demo", "--lake", str(work / "demo"))
    for campaign, control in (("2026-04", "gcp"), ("2026-10", "gcp"), ("2026-04", "model")):
        truth = DEMO / "campaigns" / campaign / "truth"
        _inspected(report, work / "demo", "demo", campaign, control, truth, f"demo {campaign}")


def main() -> None:
    """Run what is named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="+", choices=["imported", "castle", "demo"])
    parser.add_argument("--work", type=Path, help="Folder for lakes and poses; what it has from before is used again.")
    parser.add_argument("--json", type=Path, help="Also write all figures to this file.")
    arguments = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    print(
        f"{datetime.now(UTC):%Y-%m-%d}, {psutil.cpu_count()} cores, {psutil.virtual_memory().total / 2**30:.0f} GiB, "
        f"Python {platform.python_version()}"
    )
    report = Report()
    with tempfile.TemporaryDirectory() as scratch:
        work = arguments.work or Path(scratch)
        work.mkdir(parents=True, exist_ok=True)
        for part in arguments.parts:
            {"imported": imported, "castle": castle, "demo": demo}[part](report, work)
    report.goals()
    if arguments.json:
        arguments.json.write_text(json.dumps(report.figures, indent=1))


if __name__ == "__main__":
    main()
