"""Tests of the worker's own modules; ``test_worker.py`` runs them in a process of their own, for they load pycolmap."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

from facadelake.pose.worker.descriptors import representative_descriptors


def synthetic(path: Path, *, photographs: int, points: int) -> pycolmap.Reconstruction:
    """A block of known truth, and its database."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs = options.num_cameras_per_rig = 1
    options.num_frames_per_rig, options.num_points3D = photographs, points
    pycolmap.set_random_seed(1)
    with pycolmap.Database.open(path) as database:
        return pycolmap.synthesize_dataset(options, database)


def test_each_point_has_a_descriptor_of_its_own_track_nearest_to_the_mean(tmp_path: Path) -> None:
    model = synthetic(tmp_path / "a.db", photographs=7, points=40)
    rng = np.random.default_rng(3)
    with pycolmap.Database.open(tmp_path / "a.db") as database:
        plain = {image_id: database.read_descriptors(image_id) for image_id in model.images}
        held = {i: np.clip(d.data + rng.normal(0, 20, d.data.shape), 0, 255).astype(np.uint8) for i, d in plain.items()}
        database.clear_descriptors()
        for image_id, data in held.items():
            database.write_descriptors(image_id, pycolmap.FeatureDescriptors(data=data, type=plain[image_id].type))
    point_ids = sorted(model.points3D)
    found = representative_descriptors(model, tmp_path / "a.db", {p: row for row, p in enumerate(point_ids)})
    assert found.dtype == np.uint8
    for row, point_id in enumerate(point_ids):
        track = np.array(
            [held[e.image_id][e.point2D_idx] for e in model.points3D[point_id].track.elements], dtype=float
        )
        expected = track[np.argmin(np.linalg.norm(track - track.mean(axis=0), axis=1))]
        np.testing.assert_array_equal(found[row], expected)
