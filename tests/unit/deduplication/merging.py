"""Observations on a wall y = 0 that faces south, for the tests of merging."""

import numpy as np

from facadelake.deduplication.observations import ObservationArrays


def make_observations(places, photo, *, size_m=0.2, kinds=None, boxes=None, eyes=None):
    """Observations at ``places`` (n, 2: x, z), each in ``photo`` (n,), from ``eyes`` (n, 3) or square-on from 10 m.

    ``size_m``: a number, or width and height of each (n, 2).
    """
    places = np.asarray(places, dtype=float).reshape(-1, 2)
    n = len(places)
    xyz = np.column_stack([places[:, 0], np.zeros(n), places[:, 1]])
    away = xyz - (xyz - [0, 10.0, 0] if eyes is None else np.asarray(eyes, dtype=float))
    distance = np.linalg.norm(away, axis=1)
    size = np.broadcast_to(np.asarray(size_m, dtype=float).reshape(-1, 1) if np.ndim(size_m) < 2 else size_m, (n, 2))
    return ObservationArrays(
        xyz_site_m=xyz,
        normal_site=np.tile([0.0, -1, 0], (n, 1)),
        ray_site=away / distance[:, None],
        distance_m=distance,
        width_m=size[:, 0].copy(),
        height_m=size[:, 1].copy(),
        gsd_m=np.full(n, 0.003),
        photo=np.asarray(photo, dtype=np.int64),
        defect_class=np.zeros(n, dtype=np.int64) if kinds is None else np.asarray(kinds, dtype=np.int64),
        box_img=np.full((n, 4), np.nan) if boxes is None else np.asarray(boxes, dtype=float),
        pose_covariance_m2=np.zeros((n, 3, 3)),
    )
