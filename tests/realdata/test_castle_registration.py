"""Registration alone: the castle's published cameras imported as poses, by poses.csv and as COLMAP's text files.

No reconstruction and no lake; benchmarks/registration.py prints the same figures with the goals beside them.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.published_poses import write_published_poses
from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.model import BuildingModel
from facadelake.building.surface.raycasting import Surface
from facadelake.core.pose_table import read_pose_covariances, read_posed_cameras
from facadelake.deduplication.merge import merge_observations
from facadelake.deduplication.settings import MergeSettings
from facadelake.detection.coco.import_detections import import_coco
from facadelake.evaluation.campaigns.comparison import compare_with_truth
from facadelake.evaluation.campaigns.evaluate import compute_figures
from facadelake.evaluation.campaigns.figures import CampaignFigures
from facadelake.georeferencing.imported.placement import ImportedPlacement, place_imported_poses
from facadelake.georeferencing.imported.pose_files import read_poses
from facadelake.georeferencing.site_frame import SiteFrame
from facadelake.photos.ingest import ingest_photographs
from facadelake.registration.observation import observe_detections
from facadelake.registration.settings import RegistrationSettings
from schemas.vocabulary import ControlKind

pytestmark = pytest.mark.realdata


class Castle:
    """The castle's model and photographs, read once."""

    def __init__(self, data: Path) -> None:
        self.root = data / "castle"
        self.model: BuildingModel = load_ifc_building(self.root / "castle.ifc", settings=IfcModelSettings())
        self.surface = Surface(self.model)
        self.photos: pa.Table = ingest_photographs(
            self.root / "images", distance_to_model_m=None, close_range_below_m=8.0
        )

    def placed(self, path: Path) -> ImportedPlacement:
        model = self.model
        site_frame = SiteFrame(
            origin=model.origin, map_crs=model.map_crs, vertical_datum=model.vertical_datum,
            georeference_level=model.georeference_level,
        )  # fmt: skip
        return place_imported_poses(
            read_poses(path), self.photos, site_frame=site_frame, surface=self.surface, placement_sigma_max_m=0.5
        )

    def figures(self, placed: ImportedPlacement, boxes: str) -> CampaignFigures:
        posed, covariances = read_posed_cameras(placed.poses), read_pose_covariances(placed.poses)
        found = import_coco(self.root / boxes, self.photos, class_names={})
        seen = observe_detections(
            found, posed, self.model, self.surface, settings=RegistrationSettings(), covariances=covariances
        )
        merged = merge_observations(
            seen, found, self.model, posed, prefix="castle",
            settings=MergeSettings.build_for_control(ControlKind.IMPORTED),
            covariances=covariances,
        )  # fmt: skip
        compared = compare_with_truth(
            photos=self.photos, poses=placed.poses, detections=found, observations=merged.observations,
            defects=merged.defects, truth=self.root / "truth", origin=self.model.origin, map_crs=self.model.map_crs,
        )  # fmt: skip
        return compute_figures(compared)


@pytest.fixture(scope="module")
def castle(shared_data: Path) -> Castle:
    return Castle(shared_data)


def test_published_cameras_as_poses(castle: Castle, tmp_path: Path) -> None:
    placed = castle.placed(write_published_poses(castle.root / "truth", tmp_path / "poses.csv", noise=None))
    assert placed.localised == 29
    exact = castle.figures(placed, "detections.coco.json")
    assert (exact.camera_error.mae or 1) < 1e-4  # m: eleven digits of truth's degrees
    # methods.md: 4.4 cm is the ceiling of the surface, whose relief is not in the model; less would be too good.
    assert 0.035 < (exact.observation_error.distance.mean or 0) < 0.045
    # The check points were triangulated with these cameras, from image marks whose rays intersect to 4 mm.
    assert 0.0005 < (exact.defect_error.distance.mae or 0) < 0.01
    assert (exact.merge.f1 or 0) >= 0.99
    assert exact.check_points.lost == exact.check_points.duplicated == 0
    noisy = castle.figures(placed, "detections_noisy.coco.json")
    assert (noisy.merge.f1 or 0) >= 0.97
    assert 0.005 < (noisy.defect_error.distance.mae or 0) < 0.05  # jittered boxes


def test_the_same_cameras_as_colmap_text(castle: Castle, tmp_path: Path) -> None:
    """Written by hand in grid coordinates less an offset, by PROJ's own convergence: a millimetre, an arc second."""
    offset = np.array([456000.0, 5421000.0, 100.0])
    utm = pyproj.Proj("EPSG:25832")
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 3072 2048 2759.48 2764.16 1520.69 1006.81\n")
    lines = []
    with (castle.root / "truth" / "cameras.csv").open() as stream:
        for i, row in enumerate(csv.DictReader(stream), start=1):
            lon, lat, height = (float(row[name]) for name in ("lon_deg", "lat_deg", "height_ellipsoidal_m"))
            centre = np.array([*utm(lon, lat), height]) - offset
            cam_from_site = np.array([[float(row[f"cam_from_site_r{a}{b}"]) for b in range(3)] for a in range(3)])
            # Grid north lies the convergence clockwise of true north.
            convergence = np.radians(utm.get_factors(lon, lat).meridian_convergence)
            grid_from_site = Rotation.from_euler("z", convergence).as_matrix()
            cam_from_grid = cam_from_site @ grid_from_site.T
            x, y, z, w = Rotation.from_matrix(cam_from_grid).as_quat()
            shift = " ".join(f"{value:.9f}" for value in -cam_from_grid @ centre)
            lines.append(f"{i} {w:.12f} {x:.12f} {y:.12f} {z:.12f} {shift} 1 {row['image']}\n\n")
    (tmp_path / "images.txt").write_text("".join(lines))
    (tmp_path / "georeference.txt").write_text("crs: EPSG:25832\noffset: 456000 5421000 100\n")
    colmap = read_posed_cameras(castle.placed(tmp_path).poses)
    (tmp_path / "csv").mkdir()
    table = read_posed_cameras(
        castle.placed(write_published_poses(castle.root / "truth", tmp_path / "csv" / "poses.csv", noise=None)).poses
    )
    assert len(colmap) == len(table) == 29
    for name, camera in table.items():
        np.testing.assert_allclose(colmap[name].centre_site_m, camera.centre_site_m, rtol=0, atol=1e-3)  # m
        turn = colmap[name].site_from_cam.rotation.T @ camera.site_from_cam.rotation
        angle_deg = np.degrees(np.linalg.norm(Rotation.from_matrix(turn).as_rotvec()))
        assert angle_deg < 0.001  # of 0.45 deg of convergence, with truth's site axes 30 m off
