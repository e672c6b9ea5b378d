"""Tests of the worker's modules; ``test_worker.py`` runs them in a process of their own because they load pycolmap."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest

from benchmarks.synthetic_block import HEIGHT_PX, WIDTH_PX, generate_flight, write_block
from facadelake.core.frames import estimate_similarity
from facadelake.sfm.worker.export import select_descriptors
from facadelake.sfm.worker.features import limit_threads, open_database
from facadelake.sfm.worker.focal_deviations import separate_focal_deviations
from facadelake.sfm.worker.joining import join_blocks
from facadelake.sfm.worker.mapping import adjust_block, compute_tolerance_factor, map_photographs
from facadelake.sfm.worker.report import ProgressReport
from facadelake.sfm.worker.resection import resect_remaining
from facadelake.sfm.worker.retrieval import pair_by_appearance, pair_transitively

CAMERA = {"width_px": 1024, "height_px": 768, "focal_px": 1280.0, "focal_known": True}
SETTINGS = {"max_image_px": 1024, "seed": 1}


def silent() -> ProgressReport:
    return ProgressReport(stream=io.StringIO())


def job_of(photographs: int) -> dict[str, Any]:
    photo = {"camera": 0, "prior_m": None, "prior_sigma_m": None}
    photos = [{"photo_id": f"{k:03d}.jpg", **photo} for k in range(photographs)]
    return {"cameras": [CAMERA], "settings": SETTINGS, "photos": photos, "cores": 4}


def synthetic(path: Path, *, photographs: int, points: int) -> pycolmap.Reconstruction:
    """A block of known truth, and its database with keypoints of sigma 0.5 px."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs = options.num_cameras_per_rig = 1
    options.num_frames_per_rig, options.num_points3D = photographs, points
    options.camera_has_prior_focal_length = True
    pycolmap.set_random_seed(1)
    with pycolmap.Database.open(path) as database:
        model = pycolmap.synthesize_dataset(options, database)
        noise = pycolmap.SyntheticNoiseOptions()
        noise.point2D_stddev = 0.5
        pycolmap.synthesize_noise(noise, model, database)
        return model


def test_the_descriptor_of_a_point_is_that_of_an_image_point_nearest_to_the_mean(tmp_path: Path) -> None:
    model = synthetic(tmp_path / "a.db", photographs=7, points=40)
    rng = np.random.default_rng(3)
    with pycolmap.Database.open(tmp_path / "a.db") as database:
        plain = {image_id: database.read_descriptors(image_id) for image_id in model.images}
        held = {i: np.clip(d.data + rng.normal(0, 20, d.data.shape), 0, 255).astype(np.uint8) for i, d in plain.items()}
        database.clear_descriptors()
        for image_id, data in held.items():
            database.write_descriptors(image_id, pycolmap.FeatureDescriptors(data=data, type=plain[image_id].type))
    point_ids = sorted(model.points3D)
    found = select_descriptors(model, tmp_path / "a.db", {p: row for row, p in enumerate(point_ids)})
    assert found.dtype == np.uint8
    for row, point_id in enumerate(point_ids):
        track = np.array(
            [held[e.image_id][e.point2D_idx] for e in model.points3D[point_id].track.elements], dtype=float
        )
        expected = track[np.argmin(np.linalg.norm(track - track.mean(axis=0), axis=1))]
        np.testing.assert_array_equal(found[row], expected)


def without(model: pycolmap.Reconstruction, image_id: int) -> pycolmap.Rigid3d:
    """Take a photograph out of the block; returns its true pose."""
    image = model.images[image_id]
    pose = image.cam_from_world()
    model.deregister_frame(image.frame_id)
    return pose


def keep_matches(path: Path, image_id: int, kept: np.ndarray) -> None:
    """Of the photograph's matches keep those of its keypoints ``kept``, and add as many wrong ones."""
    rng = np.random.default_rng(1)
    with pycolmap.Database.open(path) as database:
        others = [image.image_id for image in database.read_all_images() if image.image_id != image_id]
        for other in others:
            matches = database.read_matches(image_id, other)
            held = matches[np.isin(matches[:, 0], kept)]
            wrong = np.column_stack([held[:, 0], rng.permutation(matches[:, 1])[: len(held)]]).astype(np.uint32)
            database.delete_matches(image_id, other)
            database.write_matches(image_id, other, np.vstack([held, wrong]))


def test_a_photograph_outside_is_resected_with_its_correspondences(tmp_path: Path) -> None:
    model = synthetic(tmp_path / "a.db", photographs=6, points=150)
    truth = without(model, 3)
    keep_matches(tmp_path / "a.db", 3, np.arange(0, 150, 8))
    assert resect_remaining(model, job_of(6), tmp_path / "a.db", silent()) == {}
    image = model.images[3]
    found = image.cam_from_world()
    # 0.5 px of 1280 at 5 units' distance is 0.002 units; 19 points determine the centre to about that.
    distance = np.linalg.norm(found.inverse().translation - truth.inverse().translation)
    assert 1e-5 < distance < 0.02
    turned = (found.rotation * truth.rotation.inverse()).angle()
    assert 1e-6 < turned < 0.005  # rad
    assert 15 <= image.num_points3D <= 19
    for index, point in zip(image.get_observation_point2D_idxs(), image.get_observation_points2D(), strict=True):
        assert any(e.image_id == 3 and e.point2D_idx == index for e in model.points3D[point.point3D_id].track.elements)
        error = np.linalg.norm(np.asarray(image.project_point(model.points3D[point.point3D_id].xyz)) - point.xy)
        assert error < 4.0  # px


def test_too_few_or_too_close_correspondences_are_refused_with_the_reason(tmp_path: Path) -> None:
    model = synthetic(tmp_path / "a.db", photographs=6, points=100)
    without(model, 3)
    keep_matches(tmp_path / "a.db", 3, np.arange(0, 100, 10))
    few = resect_remaining(model, job_of(6), tmp_path / "a.db", silent())
    assert few[3].endswith("12 are needed")
    crowded = synthetic(tmp_path / "b.db", photographs=4, points=4000)
    without(crowded, 3)
    seen = np.array([point.xy for point in crowded.images[3].points2D])
    together = np.argsort(np.linalg.norm(seen - np.median(seen, axis=0), axis=1))[:18]  # 40 of 1024 px
    keep_matches(tmp_path / "b.db", 3, together)
    reasons = resect_remaining(crowded, job_of(4), tmp_path / "b.db", silent())
    assert "are too close together" in reasons[3]
    assert 3 not in crowded.images


def test_two_blocks_that_share_photographs_become_one(tmp_path: Path) -> None:
    model = synthetic(tmp_path / "a.db", photographs=12, points=200)
    model.write(tmp_path)
    truth = {image_id: model.images[image_id].projection_center() for image_id in model.reg_image_ids()}
    first, second = pycolmap.Reconstruction(tmp_path), pycolmap.Reconstruction(tmp_path)
    for image_id in (9, 10, 11, 12):
        without(first, image_id)
    for image_id in (1, 2, 3, 4, 5):
        without(second, image_id)
    moved = pycolmap.Sim3d(2.0, pycolmap.Rotation3d(np.array([0.0, 0, 1]) * 0.7), np.array([3.0, -1, 2]))
    second.transform(moved)
    block, apart = join_blocks([first, second], tmp_path / "a.db", silent())
    assert not apart
    assert sorted(block.reg_image_ids()) == list(range(1, 13))
    for image_id, centre in truth.items():
        np.testing.assert_allclose(block.images[image_id].projection_center(), centre, rtol=0, atol=0.02)
    assert all(block.images[image_id].num_points3D > 150 for image_id in (9, 10, 11, 12))
    for image_id in (6, 7, 8):
        without(second, image_id)
    alone = pycolmap.Reconstruction(tmp_path)
    for image_id in (9, 10, 11, 12):
        without(alone, image_id)
    assert len(join_blocks([alone, second], tmp_path / "a.db", silent())[1]) == 1


def test_mapping_is_repeated_from_other_pairs_where_the_block_is_small(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Attempts that localise 3, 8 and 12 of 12 photographs: the second is enough. A finished one is not repeated."""
    synthetic(tmp_path / "a.db", photographs=12, points=50).write(tmp_path)
    seeds: list[int] = []

    def mapped(*_: Any, options: pycolmap.IncrementalPipelineOptions, **__: Any) -> dict[int, pycolmap.Reconstruction]:
        seeds.append(options.random_seed)
        model = pycolmap.Reconstruction(tmp_path)
        for image_id in list(model.reg_image_ids())[[3, 8, 12][len(seeds) - 1] :]:
            without(model, image_id)
        return {0: model}

    monkeypatch.setattr(pycolmap, "incremental_mapping", mapped)
    job = job_of(12) | {"photographs_root": str(tmp_path)}
    (block,) = map_photographs(job, tmp_path / "a.db", silent())
    assert block.num_reg_images() == 8
    assert seeds == [1, 2]
    map_photographs(job, tmp_path / "a.db", silent())
    assert seeds == [1, 2, 3]  # the mock writes no models to resume from, so one more attempt is made


def test_zoomed_photographs_that_no_metadata_tell_apart_have_a_camera_of_their_own(tmp_path: Path) -> None:
    """48 photographs around a house at 9 m, six of them zoomed by 1.3: with one camera these lie 2 m from the truth,
    with residuals below half a pixel."""
    rng, count, zoomed = np.random.default_rng(1), 48, [10, 11, 12, 20, 21, 35]
    flight = generate_flight(count, rng)
    near = np.linalg.norm(flight.centres_m[:, None] - flight.centres_m[None], axis=2) < 10
    alike = flight.directions @ flight.directions.T > 0.3
    pairs = [(int(i), int(j)) for i, j in np.argwhere(np.triu(near & alike, 1))]
    zoom = np.where(np.isin(np.arange(count), zoomed), 1.3, 1.0)
    truth = write_block(tmp_path / "a.db", flight, pairs, observations=500, rng=rng, zoom=zoom)
    job = job_of(count) | {
        "cameras": [{"width_px": WIDTH_PX, "height_px": HEIGHT_PX, "focal_px": 2950.0, "focal_known": True}],
        "photos": [{"photo_id": name, "camera": 0, "prior_m": None, "prior_sigma_m": None} for name in truth],
        "photographs_root": str(tmp_path),
        "settings": SETTINGS | {"max_image_px": 3200},
        "cores": 2,
    }
    model = map_photographs(job, tmp_path / "a.db", silent())[0]
    adjust_block(model, job, silent())
    failures = resect_remaining(model, job, tmp_path / "a.db", silent())
    assert measure_errors(model, truth, zoom)[zoomed].min() > 1.0  # m; nothing else shows it
    assert model.compute_mean_reprojection_error() < 0.6
    deviations = separate_focal_deviations(model, job, tmp_path / "a.db", failures, silent())
    found = {deviation.image_id - 1: deviation for deviation in deviations}
    assert set(found) == set(zoomed) - {image_id - 1 for image_id in failures}
    for deviation in found.values():
        assert abs(deviation.factor - 1.3) < 0.02 + 3 * deviation.sigma
    errors_m = measure_errors(model, truth, zoom)
    assert 1e-4 < np.nanmedian(errors_m[zoomed]) < 0.03
    assert np.nanmax(errors_m) < 0.1
    assert separate_focal_deviations(model, job, tmp_path / "a.db", failures, silent()) == []


def measure_errors(model: pycolmap.Reconstruction, truth: dict[str, np.ndarray], zoom: np.ndarray) -> np.ndarray:
    """Distances (n,) of the cameras from the truth, m, after a similarity by those without zoom; NaN outside."""
    names = sorted(truth)
    images = {model.images[image_id].name: model.images[image_id] for image_id in model.reg_image_ids()}
    xyz = np.array([images[n].projection_center() if n in images else np.full(3, np.nan) for n in names])
    true = np.array([truth[name] for name in names])
    plain = (zoom == 1.0) & np.isfinite(xyz).all(axis=1)
    distances: np.ndarray = np.linalg.norm(estimate_similarity(xyz[plain], true[plain]).apply(xyz) - true, axis=1)
    return distances


def test_photographs_of_one_place_are_paired_by_appearance(tmp_path: Path) -> None:
    """Eight places, five photographs of each: noisy copies of the place's descriptors among foreign ones."""
    rng = np.random.default_rng(2)
    job = job_of(40)
    image_id_of = open_database(job, tmp_path / "a.db")
    places = rng.integers(0, 120, (8, 150, 128))
    with pycolmap.Database.open(tmp_path / "a.db") as database:
        for index, image_id in image_id_of.items():
            own = places[index // 5][rng.permutation(150)[:100]] + rng.normal(0, 12, (100, 128))
            found = np.clip(np.vstack([own, rng.integers(0, 120, (200, 128))]), 0, 255).astype(np.uint8)
            kind = pycolmap.FeatureExtractorType.SIFT
            database.write_keypoints(image_id, np.ones((300, 6), dtype=np.float32))
            database.write_descriptors(image_id, pycolmap.FeatureDescriptors(data=found, type=kind))
    pairs = pair_by_appearance(job, list(range(40)), 4, tmp_path / "a.db", image_id_of)
    assert len(pairs) <= 160
    same = {(i, j) for i in range(40) for j in range(i + 1, 40) if i // 5 == j // 5}
    assert len(same & set(pairs)) > 0.95 * len(same)
    assert all(7 in pair for pair in pair_by_appearance(job, [7], 4, tmp_path / "a.db", image_id_of))
    assert pair_by_appearance(job, [], 4, tmp_path / "none.db", image_id_of) == []


def test_partners_of_partners_are_compared_the_strongest_first(tmp_path: Path) -> None:
    """A chain 0-1-2-3 with a strong link 1-2, and 1-4 that did not match."""
    image_id_of = open_database(job_of(5), tmp_path / "a.db")
    inliers = {(0, 1): 50, (1, 2): 90, (2, 3): 20, (1, 4): 0}
    with pycolmap.Database.open(tmp_path / "a.db") as database:
        for (i, j), count in inliers.items():
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = int(pycolmap.TwoViewGeometryConfiguration.CALIBRATED)
            geometry.inlier_matches = np.zeros((count, 2), dtype=np.uint32)
            database.write_two_view_geometry(image_id_of[i], image_id_of[j], geometry)
    args = (sorted(inliers), 4, tmp_path / "a.db", image_id_of)
    assert pair_transitively([0, 3], *args) == [(0, 2), (1, 3)]
    assert pair_transitively([4], *args) == []
    more = [*sorted(inliers), (0, 3)]
    assert pair_transitively([2], more, 1, tmp_path / "a.db", image_id_of) == [(0, 2)]


def test_a_database_is_reused_if_intact_else_replaced(tmp_path: Path) -> None:
    job = job_of(4)
    path = tmp_path / "features.db"
    (tmp_path / "features.db.partial").write_bytes(b"of a killed run")
    assert open_database(job, path) == {0: 1, 1: 2, 2: 3, 3: 4}
    with pycolmap.Database.open(path) as database:
        assert database.read_camera(1).model == pycolmap.CameraModelId.OPENCV
        database.write_keypoints(2, np.ones((5, 6), dtype=np.float32))
    open_database(job, path)
    with pycolmap.Database.open(path) as database:
        assert database.num_keypoints_for_image(2) == 5
    path.write_bytes(path.read_bytes()[:5000] + b"damaged" * 400)
    (tmp_path / "models-0").mkdir()
    open_database(job, path)
    assert [left.name for left in tmp_path.iterdir()] == [
        "features.db"
    ]  # what was made from the damaged one is removed
    with pycolmap.Database.open(path) as database:
        assert database.num_images() == 4
        assert database.num_keypoints_for_image(2) == 0


def test_a_camera_with_few_photographs_has_a_simple_model(tmp_path: Path) -> None:
    job = job_of(3)
    open_database(job, tmp_path / "a.db")
    with pycolmap.Database.open(tmp_path / "a.db") as database:
        assert database.read_camera(1).model == pycolmap.CameraModelId.SIMPLE_RADIAL


@pytest.mark.parametrize(("longer_side_px", "factor"), [(1600, 1.0), (3072, 1.0), (8000, 2.5)])
def test_tolerances_grow_with_the_reduction(longer_side_px: int, factor: float) -> None:
    cameras = [CAMERA | {"width_px": longer_side_px, "height_px": longer_side_px // 2}, CAMERA]
    assert compute_tolerance_factor({"cameras": cameras, "settings": {"max_image_px": 2000}}) == factor


@pytest.mark.parametrize(("free_gib", "threads"), [(64, 4), (1.8, 2), (0.3, 1)])
def test_free_memory_bounds_the_threads(free_gib: float, threads: int) -> None:
    """48 Mpx photographs reduced to 2000 px: 0.4 GB each."""
    job = {**job_of(3), "cameras": [CAMERA | {"width_px": 8000, "height_px": 6000}]}
    job["settings"] = {"max_image_px": 2000}
    assert limit_threads(job, int(free_gib * 2**30)) == threads
