from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa

from facadelake.core.geodesy import SiteOrigin
from facadelake.core.pose_table import columns_from_camera
from facadelake.reporting.history.comparison import compare_campaigns
from facadelake.reporting.history.draw import BuildingTables, read_photographs, write_comparison
from tests.unit.reporting.history.painted_history import ORIGIN, History, make_table
from tests.unit.reporting.painted_wall import NASTY_NAME, PaintedWall
from tests.unit.reporting.test_report import read


def make_tables(painted: PaintedWall, origins: dict[str, SiteOrigin]) -> dict[str, pa.Table]:
    """Two campaigns with the same photographs; ``origins``: those of their site frames."""
    history = History(("2025", "2026"))
    history.add("wall-0001", {"2025": "first_seen detected", "2026": "grown detected"}, (4.0, 2.0))
    history.resize("wall-0001", "2026", length_m=0.8)
    for row in history.rows["campaigns"]:
        row["photographs_uri"] = str(painted.root)
    buildings: list[dict[str, Any]] = []
    poses: list[dict[str, Any]] = []
    for campaign, origin in origins.items():
        key = {"building_id": "wall", "campaign_id": campaign, "run_id": campaign}
        named = {f"origin_{name}": value for name, value in vars(origin).items()}
        buildings.append(key | named | {"building_name": NASTY_NAME})
        poses += [
            key | columns_from_camera(pose) | {"photo_id": name, "pose_source": "sfm", "tie_points": 9}
            | {"image_width_px": pose.camera.width_px, "image_height_px": pose.camera.height_px}
            for name, pose in painted.posed.items()
        ]  # fmt: skip
    return {**history.tables, "buildings": make_table("buildings", buildings), "poses": make_table("poses", poses)}


def test_a_building_that_is_no_longer_registered_has_a_page_with_pairs(painted: PaintedWall, tmp_path: Path) -> None:
    """The photographs are where they were; without the model the planes of the defects stand for it."""
    tables = make_tables(painted, {"2025": ORIGIN, "2026": ORIGIN})
    history = BuildingTables(building_id="wall", lake=tmp_path, version=None, tables=tables)
    # The number of defect wall-0001-in-2026 among those of its campaign is 2026.
    card = tmp_path / "published" / "wall" / "2026" / "v000004" / "cards" / "card_2026.png"
    card.parent.mkdir(parents=True)
    card.write_bytes(b"")
    folder = tmp_path / "comparisons" / "wall" / "2025_to_2026"
    path = write_comparison(compare_campaigns(tables, None, None), history, None, folder)
    page = read(path)
    assert "No elevations: the portfolio does not have building 'wall'" in page.text
    pictures = [
        cv2.imread(str(folder / "pairs" / f"wall-0001_{word}.jpg")) for word in ("before", "after", "difference")
    ]
    assert len({picture.shape for picture in pictures}) == 1
    assert np.abs(pictures[0].astype(float) - pictures[1]).mean() < 3  # grey levels: the same photographs
    assert "../../../published/wall/2026/v000004/cards/card_2026.png" in page.links
    assert (path.parent / "../../../published/wall/2026/v000004/cards/card_2026.png").is_file()


def test_poses_of_another_site_frame_are_moved_into_the_later_one(painted: PaintedWall, tmp_path: Path) -> None:
    """A model that moved its origin by 10 m east and 5 m up between two campaigns."""
    lon, lat, height = ORIGIN.geo_from_site(np.array([[10.0, 0.0, 5.0]]))[0].tolist()
    moved = SiteOrigin(lon_deg=lon, lat_deg=lat, height_ellipsoidal_m=height)
    tables = make_tables(painted, {"2025": moved, "2026": ORIGIN})
    history = BuildingTables(building_id="wall", lake=tmp_path, version=None, tables=tables)
    found = read_photographs(history, None, "2025", ORIGIN)
    for name, pose in painted.posed.items():
        shift = found.posed[name].centre_site_m - pose.centre_site_m
        np.testing.assert_allclose(shift, [10.0, 0.0, 5.0], rtol=0, atol=1e-3)  # m: up turns by 1.6e-6 rad
