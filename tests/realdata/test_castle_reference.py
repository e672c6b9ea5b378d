"""Two campaigns of four real photographs each, at a third of their size: the one found in the frame of the other.

Four photographs leave a block stretched by decimetres (the adjustment that follows mends that), so what is held against
truth is which point is which: both campaigns' image points are intersected with the published cameras.
"""

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity, estimate_similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.campaign.matching import match_reference
from facadelake.georeferencing.campaign.reference import ReferencePoints, read_reference
from facadelake.georeferencing.campaign.reference_selection import build_reference
from facadelake.georeferencing.triangulation import ImageRay, intersect_rays
from facadelake.photos.ingest import ingest_photographs
from facadelake.sfm.reconstruction import Reconstruction, read_descriptors, read_reconstruction
from facadelake.sfm.reconstruction_job import reconstruct
from facadelake.sfm.settings import ReconstructionSettings
from facadelake.sfm.tie_point_covariance import compute_tie_point_covariance, estimate_pixel_sigma

pytestmark = pytest.mark.realdata

ORIGIN = SiteOrigin(lon_deg=8.4078, lat_deg=48.9405, height_ellipsoidal_m=180.0)
EARLIER, LATER = (2, 4, 6, 8), (3, 5, 7, 9)


@dataclass(frozen=True)
class Half:
    """Every other photograph of the main facade: the block, and the published cameras in its photographs' order."""

    reconstruction: Reconstruction
    descriptors: np.ndarray
    published: list[PosedCamera]

    def by_truth(self) -> Similarity:
        """site_from_sfm by the published centres."""
        centres = np.array([posed.centre_site_m for posed in self.published])
        return estimate_similarity(self.reconstruction.centres_sfm, centres)

    def intersect(self, row: int) -> np.ndarray | None:
        """Where the published cameras see tie point ``row``, from its image points alone."""
        sfm = self.reconstruction
        tracks = np.flatnonzero(sfm.image_point_tie_point == row)
        cameras = [self.published[sfm.image_point_photo[k]] for k in tracks]
        views = [
            ImageRay(camera=posed.camera, world_from_cam=posed.site_from_cam, xy_img=sfm.image_point_xy_img[k])
            for posed, k in zip(cameras, tracks, strict=True)
        ]
        point = intersect_rays(views)
        return None if point is None else point.xyz_world


def parse_published_camera(row: dict[str, str]) -> PosedCamera:
    """A line of truth."""
    fx, fy, cx, cy = (float(row[f"{name}_px"]) for name in ("fx", "fy", "cx", "cy"))
    cam_from_site = np.array([[float(row[f"cam_from_site_r{i}{j}"]) for j in range(3)] for i in range(3)])
    return PosedCamera(
        camera=Camera(width_px=3072, height_px=2048, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy),
        site_from_cam=Similarity(
            rotation=Rotation.from_matrix(cam_from_site.T).as_matrix(),  # nine digits are not quite orthonormal
            translation=np.array([float(row[f"{axis}_site_m"]) for axis in "xyz"]),
        ),
    )


def reconstruct_half(castle: Path, numbers: tuple[int, ...], root: Path) -> Half:
    """Reconstruct some photographs."""
    images = root / "images" / "multiview"
    images.mkdir(parents=True)
    for n in numbers:
        (images / f"IMG_{n:04}.JPG").symlink_to(castle / "images" / "multiview" / f"IMG_{n:04}.JPG")
    photos = ingest_photographs(root / "images", distance_to_model_m=None, close_range_below_m=10.0)
    (root / "sfm").mkdir()
    reconstruct(photos, root / "images", root / "sfm", ReconstructionSettings(max_image_px=1000, max_features=3000))
    found = read_reconstruction(root / "sfm")
    with (castle / "truth" / "cameras.csv").open() as stream:
        truth = {row["image"]: parse_published_camera(row) for row in csv.DictReader(stream)}
    return Half(found, read_descriptors(root / "sfm"), [truth[photo.photo_id] for photo in found.photos])


@pytest.fixture(scope="module")
def halves(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Half, Half]:
    """The earlier and the later campaign."""
    castle, root = shared_data / "castle", tmp_path_factory.mktemp("halves")
    return reconstruct_half(castle, EARLIER, root / "earlier"), reconstruct_half(castle, LATER, root / "later")


@pytest.fixture(scope="module")
def reference(halves: tuple[Half, Half], tmp_path_factory: pytest.TempPathFactory) -> ReferencePoints:
    """The earlier campaign's reference, placed by truth, through its file."""
    sfm = halves[0].reconstruction
    site_from_sfm = halves[0].by_truth()
    cameras = [
        PosedCamera(
            camera=photo.camera,
            site_from_cam=Similarity(
                rotation=site_from_sfm.rotation @ photo.sfm_from_cam.rotation,
                translation=site_from_sfm.apply(photo.sfm_from_cam.translation),
            ),
        )
        for photo in sfm.photos
    ]
    xyz = site_from_sfm.apply(sfm.xyz_sfm)
    path = tmp_path_factory.mktemp("reference") / "reference.npz"
    build_reference(
        sfm,
        halves[0].descriptors,
        cameras=cameras,
        xyz_site_m=xyz,
        covariance_m2=compute_tie_point_covariance(sfm, cameras, xyz, sigma_px=estimate_pixel_sigma(sfm)),
        frame_covariance_m2=np.eye(3) * 1e-3,
        building_id="castle",
        campaign_id="earlier",
        origin=ORIGIN,
    ).save(path)
    return read_reference(path)


def test_the_points_found_again_are_the_same_points(halves: tuple[Half, Half], reference: ReferencePoints) -> None:
    earlier, later = halves
    assert [len(campaign.reconstruction.photos) for campaign in halves] == [4, 4]
    found = match_reference(later.reconstruction, later.descriptors, reference, origin=ORIGIN)
    assert len(found.point) > 80
    assert found.agreeing > 0.7 * found.pairs
    assert found.runner_up < 0.1 * found.agreeing
    assert 0.3 < found.misfit < 1.3
    row_of = cKDTree(earlier.by_truth().apply(earlier.reconstruction.xyz_sfm)).query(reference.xyz_site_m)[1]
    step_m = []
    for point, row in list(zip(found.point.tolist(), found.reference.tolist(), strict=True))[::3]:
        here, there = later.intersect(point), earlier.intersect(int(row_of[row]))
        if here is not None and there is not None:
            step_m.append(np.linalg.norm(here - there))
    assert len(step_m) > 30
    assert 0.001 < np.median(step_m) < 0.03  # m; a pixel of the reduced photographs is 2 cm there
    assert np.mean(np.array(step_m) < 0.25) > 0.95  # m; wrong pairs would lie metres apart


def test_another_part_of_the_courtyard_is_refused(halves: tuple[Half, Half], reference: ReferencePoints) -> None:
    """The reference knows the facade left of its middle, the campaign shows what is right of it: windows look alike."""
    later = halves[1]
    whole = match_reference(later.reconstruction, later.descriptors, reference, origin=ORIGIN)
    x_m = whole.site_from_sfm.apply(later.reconstruction.xyz_sfm)[:, 0]
    middle_m = float(np.median(reference.xyz_site_m[:, 0]))
    left = reference.xyz_site_m[:, 0] < middle_m - 1.0
    part = replace(
        reference,
        **{name: getattr(reference, name)[left] for name in ("xyz_site_m", "covariance_m2", "descriptors")},
        **{name: getattr(reference, name)[left] for name in ("direction_site", "gsd_m", "photographs")},
    )
    right = np.where((x_m > middle_m + 1.0)[:, None], later.descriptors, 0).astype(np.uint8)
    with pytest.raises(GeoreferenceError, match=r"does not match the reference|surface that looks alike"):
        match_reference(later.reconstruction, right, part, origin=ORIGIN)
