"""Coverage of the castle by its published cameras: the photographs in which its check points were marked show them.

A person marked each check point in all photographs that show it, independent of any surface or ray.
"""

from __future__ import annotations

import csv
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.published_poses import write_published_poses
from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.model import BuildingModel
from facadelake.building.surface.raycasting import Surface
from facadelake.core.pose_table import read_posed_cameras
from facadelake.coverage import CampaignPhotographs, DetectorReach, measure_coverage
from facadelake.georeferencing.imported.placement import place_imported_poses
from facadelake.georeferencing.imported.pose_files import read_poses
from facadelake.georeferencing.site_frame import SiteFrame
from facadelake.photos.ingest import ingest_photographs

pytestmark = pytest.mark.realdata


@pytest.fixture(scope="module")
def castle(shared_data: Path) -> BuildingModel:
    return load_ifc_building(shared_data / "castle" / "castle.ifc", settings=IfcModelSettings())


@pytest.fixture(scope="module")
def measured(
    castle: BuildingModel, shared_data: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[pd.DataFrame, float]:
    """Table ``coverage``, and the seconds it took."""
    root = shared_data / "castle"
    site_frame = SiteFrame(
        origin=castle.origin, map_crs=castle.map_crs, vertical_datum=castle.vertical_datum,
        georeference_level=castle.georeference_level,
    )  # fmt: skip
    poses = write_published_poses(root / "truth", tmp_path_factory.mktemp("poses") / "poses.csv", noise=None)
    photos = ingest_photographs(root / "images", distance_to_model_m=None, close_range_below_m=8.0)
    placed = place_imported_poses(
        read_poses(poses), photos, site_frame=site_frame, surface=Surface(castle), placement_sigma_max_m=0.5
    )
    posed = read_posed_cameras(placed.poses)
    reach = DetectorReach(searched=frozenset(posed), crack_width_px=3.0)
    start = time.monotonic()
    table = measure_coverage(
        castle, CampaignPhotographs(posed=posed, root=root / "images"), reach, grazing_above_deg=80.0
    )
    return table.to_pandas(), time.monotonic() - start


def test_check_points_are_imaged_by_the_photographs_they_are_marked_in(
    castle: BuildingModel, measured: tuple[pd.DataFrame, float], shared_data: Path
) -> None:
    cells, _ = measured
    with (shared_data / "castle" / "truth" / "checkpoints.csv").open() as stream:
        points = list(csv.DictReader(stream))
    names = ("lon_deg", "lat_deg", "height_ellipsoidal_m")
    xyz = castle.origin.site_from_geo(np.array([[float(point[name]) for name in names] for point in points]))
    centres = cells[["x_site_m", "y_site_m", "z_site_m"]].to_numpy()
    gaps = np.linalg.norm(centres[None] - xyz[:, None], axis=2)
    nearest = cells.iloc[gaps.argmin(axis=1)]
    gap = gaps.min(axis=1)
    assert (gap < 0.2).mean() > 0.97  # m: half a diagonal of a cell; few points lie on cornices before the model
    assert gap.max() < 0.7  # m
    assert (nearest.element_guid.to_numpy() == np.array([point["element_guid"] for point in points])).mean() > 0.95
    marked = np.array([int(point["photographs"]) for point in points])
    assert (nearest.imaged_count.to_numpy() > 0).all()
    # A point may be marked that is at the border of a photograph; and one that is visible need not be marked.
    assert (nearest.imaged_count.to_numpy() >= marked - 1).all()


def test_gsd_is_that_of_the_lens_and_the_courtyard(measured: tuple[pd.DataFrame, float]) -> None:
    """At 2760 px and 10 to 45 m across the courtyard."""
    cells, _ = measured
    assert 3.0 < cells.gsd_mm.quantile(0.05) < cells.gsd_mm.quantile(0.95) < 20.0  # mm
    assert 0.6 < cells.blur_px.median() < 2.0  # px
    known = cells[cells.searched_count > 0]
    assert (known.found_crack_width_mm >= 3.0 * known.gsd_mm - 1e-6).all()


def test_coverage_takes_seconds(measured: tuple[pd.DataFrame, float]) -> None:
    cells, seconds = measured
    assert len(cells) > 20_000
    assert seconds < 20  # the goal is 10 s on a machine that does nothing else
