"""Coverage of the castle by its published cameras: time, memory, and the check points that it says are imaged.

    .venv/bin/python -m benchmarks.coverage

A person marked each check point in photographs that show it; the cell of a point must be imaged by about as many. The
as-built surface, which needs a reconstruction, is not used. Prints Markdown.
"""

from __future__ import annotations

import csv
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from benchmarks.foundation import SHARED
from benchmarks.published_poses import write_published_poses
from facadelake.building import read_registered_model
from facadelake.building.surface import Surface
from facadelake.core.arrays import Int64Array
from facadelake.core.pose_table import read_posed_cameras
from facadelake.coverage import CampaignPhotographs, DetectorReach, find_nearest_cells, measure_coverage
from facadelake.georeferencing import SiteFrame
from facadelake.georeferencing.imported import place_imported_poses, read_poses
from facadelake.photos import ingest_photographs
from facadelake.registry import read_portfolio

GOAL_S = 10.0
_GEO = ("lon_deg", "lat_deg", "height_ellipsoidal_m")


@dataclass(frozen=True, kw_only=True)
class CastleCoverage:
    """What was measured: ``points`` marked check points, of which ``imaged_points`` have an imaged cell.

    ``surplus`` (n,): photographs that see the cell of a point, less those in which it is marked.
    """

    photographs: int
    cells: int
    area_m2: float
    imaged_share: float
    seconds: float
    added_mib: float
    points: int
    imaged_points: int
    surplus: Int64Array


def measure_castle() -> CastleCoverage:
    """Measure the coverage of the castle campaign."""
    os.environ.setdefault("FACADELAKE_SHARED_DATA", str(SHARED))
    building = read_portfolio(Path("data/portfolio.yaml")).get_building("castle")
    model = read_registered_model(building)
    root = building.locate_photographs("2026-04")
    photos = ingest_photographs(root, distance_to_model_m=None, close_range_below_m=8.0)
    site_frame = SiteFrame(
        origin=model.origin, map_crs=model.map_crs, vertical_datum=model.vertical_datum,
        georeference_level=model.georeference_level,
    )  # fmt: skip
    truth = root.parent / "truth"
    with tempfile.TemporaryDirectory() as scratch:
        poses = read_poses(write_published_poses(truth, Path(scratch) / "poses.csv", noise=None))
    surface = Surface(model)
    placed = place_imported_poses(poses, photos, site_frame=site_frame, surface=surface, placement_sigma_max_m=0.5)
    posed = read_posed_cameras(placed.poses)
    reach = DetectorReach(searched=frozenset(posed))
    before_mib, start = psutil.Process().memory_info().rss / 2**20, time.monotonic()
    table = measure_coverage(model, CampaignPhotographs(posed=posed, root=root), reach, grazing_above_deg=80.0)
    seconds, after_mib = time.monotonic() - start, psutil.Process().memory_info().rss / 2**20
    with (truth / "checkpoints.csv").open(newline="") as stream:
        points = list(csv.DictReader(stream))
    xyz = model.origin.site_from_geo(np.array([[float(point[name]) for name in _GEO] for point in points]))
    rows = find_nearest_cells(table, xyz, max_gap_m=1.0)
    imaged = table.column("imaged_count").to_numpy()[rows[rows >= 0]]
    marked = np.array([int(point["photographs"]) for point in points])[rows >= 0]
    area = table.column("area_m2").to_numpy()
    share = area[table.column("imaged_count").to_numpy() > 0].sum() / area.sum()
    return CastleCoverage(
        photographs=len(posed),
        cells=len(table),
        area_m2=float(area.sum()),
        imaged_share=float(share),
        seconds=seconds,
        added_mib=after_mib - before_mib,
        points=len(points),
        imaged_points=int((imaged > 0).sum()),
        surplus=imaged - marked,
    )


def main() -> None:
    """Measure and print."""
    found = measure_castle()
    sys.stdout.write(
        f"| | measured | goal |\n|---|---|---|\n"
        f"| castle: {found.photographs} photographs, {found.cells} cells, {found.area_m2:.0f} m² | "
        f"{found.seconds:.1f} s | {GOAL_S:g} s |\n"
        f"| memory added | {found.added_mib:.0f} MiB | |\n"
        f"| surface imaged | {100 * found.imaged_share:.1f} % | |\n"
        f"| check points imaged | {found.imaged_points} of {found.points} | all |\n"
        f"| photographs less those marked: median (min, max) | {np.median(found.surplus):+.0f} "
        f"({found.surplus.min():+d}, {found.surplus.max():+d}) | |\n"
    )


if __name__ == "__main__":
    main()
