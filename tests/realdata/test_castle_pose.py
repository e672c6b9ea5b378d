"""Nine real photographs of the castle's main facade, from files to poses, at a third of their size.

The whole campaign is the flow's test; this one is quick and sees ingest, worker, georeference and mesh together.
"""

import csv
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from facadelake.core.frames import estimate_similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.available_control import Control
from facadelake.georeferencing.gcp.control_points import read_surveyed_points
from facadelake.georeferencing.georeference import georeference_reconstruction
from facadelake.georeferencing.georeferenced_campaign import GeoreferencedCampaign
from facadelake.georeferencing.poses_table import build_poses_table
from facadelake.georeferencing.site_frame import SiteFrame
from facadelake.photos.ingest import ingest_photographs
from facadelake.sfm.reconstruction import Reconstruction, read_reconstruction
from facadelake.sfm.reconstruction_job import reconstruct
from facadelake.sfm.settings import ReconstructionSettings
from facadelake.sfm.surface_mesh import read_mesh, write_as_built_mesh
from schemas.vocabulary import ControlKind

pytestmark = [pytest.mark.realdata, pytest.mark.slow]

ORIGIN = SiteOrigin(lon_deg=8.4078, lat_deg=48.9405, height_ellipsoidal_m=180.0)
NAMES = [
    *(f"multiview/IMG_00{n:02}.JPG" for n in (2, 3, 4, 5, 6, 7, 8)),
    "closerange/IMG_0020.JPG",
    "closerange/IMG_0022.JPG",
]


@dataclass(frozen=True)
class Block:
    """The campaign's part: photographs, reconstruction, truth of the centres (n, 3)."""

    folder: Path
    photos: pa.Table
    reconstruction: Reconstruction
    centres_site_m: np.ndarray


@pytest.fixture(scope="module")
def block(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Block:
    """Reconstruct once for the module."""
    castle, root = shared_data / "castle", tmp_path_factory.mktemp("castle")
    for name in NAMES:
        (root / "images" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(castle / "images" / name, root / "images" / name)
    photos = ingest_photographs(root / "images", distance_to_model_m=None, close_range_below_m=10.0)
    settings = ReconstructionSettings(max_image_px=1000, max_features=4000)
    reconstruct(photos, root / "images", root / "sfm", settings)
    found = read_reconstruction(root / "sfm")
    with (castle / "truth" / "cameras.csv").open() as stream:
        truth = {row["image"]: [float(row[f"{axis}_site_m"]) for axis in "xyz"] for row in csv.DictReader(stream)}
    return Block(root, photos, found, np.array([truth[photo.photo_id] for photo in found.photos]))


def georeference(block: Block, shared_data: Path, control: ControlKind) -> GeoreferencedCampaign:
    """Georeference with the castle's control points."""
    return georeference_reconstruction(
        block.reconstruction,
        block.photos,
        site_frame=SiteFrame(
            origin=ORIGIN, map_crs="EPSG:25832", vertical_datum="ellipsoidal", georeference_level="50"
        ),
        control=Control(kind=control, points=read_surveyed_points(shared_data / "castle" / "gcp_list.txt")),
    )


def compute_error_m(block: Block, found: GeoreferencedCampaign) -> np.ndarray:
    """Camera centres minus truth (n, 3)."""
    centres = np.array([found.cameras[photo.photo_id].centre_site_m for photo in block.reconstruction.photos])
    return centres - block.centres_site_m


def test_every_camera_is_placed_and_the_block_keeps_its_shape(block: Block) -> None:
    assert sorted(photo.photo_id for photo in block.reconstruction.photos) == sorted(NAMES)
    assert block.reconstruction.unlocalised == ()
    assert len({photo.camera for photo in block.reconstruction.photos}) == 1  # one camera took them all
    fit = estimate_similarity(block.reconstruction.centres_sfm, block.centres_site_m)
    off = np.linalg.norm(fit.apply(block.reconstruction.centres_sfm) - block.centres_site_m, axis=1)
    assert 0.001 < off.mean() < 0.15  # m
    assert 0.1 < block.reconstruction.mean_reprojection_error_px < 1.2  # px of the photograph as stored
    sometimes = ("Joining blocks", "Resecting photographs")  # where the first placing leaves some photographs apart
    assert [cost.step for cost in block.reconstruction.costs if cost.step not in sometimes] == [
        "Extracting features", "Matching features", "Mapping photographs", "Adjusting the block",
        "Checking focal lengths",
    ]  # fmt: skip
    assert not list((block.folder / "sfm").glob("features.db*"))  # hundreds of megabytes nobody reads again


def test_tie_points_project_onto_their_pixels(block: Block) -> None:
    """Independent of COLMAP: our camera model, our pose, its tracks."""
    sfm = block.reconstruction
    errors = []
    for k, photo in enumerate(sfm.photos):
        shown = sfm.image_point_photo == k
        cam = photo.sfm_from_cam.invert().apply(sfm.xyz_sfm[sfm.image_point_tie_point[shown]])
        off = np.linalg.norm(photo.camera.project(cam) - sfm.image_point_xy_img[shown], axis=1)
        assert off.mean() == pytest.approx(photo.reprojection_error_px, rel=0, abs=1e-6)  # px
        errors.append(off)
    assert np.concatenate(errors).max() < 4.0  # px


def test_control_points_place_it_to_centimetres_and_gps_to_metres(block: Block, shared_data: Path) -> None:
    by_control = compute_error_m(block, georeference(block, shared_data, ControlKind.GCP))
    assert 0.003 < np.linalg.norm(by_control, axis=1).mean() < 0.25  # m
    by_gps = compute_error_m(block, georeference(block, shared_data, ControlKind.GPS))
    np.testing.assert_allclose(by_gps.mean(axis=0), [1.3, -0.8, 2.1], rtol=0, atol=0.6)  # m, the bias in the tags


def test_poses_and_mesh_are_whole(block: Block, shared_data: Path) -> None:
    table = build_poses_table(
        georeference(block, shared_data, ControlKind.GCP), block.reconstruction, block.photos, origin=ORIGIN
    )
    assert table.num_rows == len(NAMES)
    assert set(table.column("pose_source").to_pylist()) == {"sfm"}
    write_as_built_mesh(block.folder / "sfm", block.folder / "mesh")
    vertices, triangles = read_mesh(block.folder / "mesh")
    assert len(triangles) > 500
    assert triangles.max() == len(vertices) - 1
