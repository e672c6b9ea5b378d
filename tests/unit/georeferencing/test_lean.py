"""The covariance of a lean, against turned cameras."""

from types import SimpleNamespace
from typing import cast

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock
from facadelake.georeferencing.model.lean import estimate_lean


def test_a_lean_moves_cameras_as_a_turned_block_does() -> None:
    rng = np.random.default_rng(1)
    wall = np.column_stack([rng.uniform(-10, 10, 4000), np.zeros(4000), rng.uniform(0, 12, 4000)])
    centre, rotation = (
        np.array([[3.0, -15.0, 2.0]]),
        Rotation.from_euler("xyz", [[100, 10, 20]], degrees=True).as_matrix(),
    )
    state = SimpleNamespace(xyz_site_m=wall, centre_site_m=centre, site_from_cam=rotation)
    walls = SimpleNamespace(point=np.arange(len(wall)))
    adjusted = SimpleNamespace(solution=SimpleNamespace(state=state), problem=SimpleNamespace(point_to_plane=walls))
    found = estimate_lean(cast(AdjustedBlock, adjusted), 0.03, None).compute_covariance(cast(AdjustedBlock, adjusted))[
        0
    ]
    sigma = 0.03 / (0.96 * 12 / 2)  # rad: the tolerance over half the height between the rims
    draws = []
    for lean in rng.normal(0, sigma, (4000, 2)):
        turn = Rotation.from_rotvec([*lean, 0.0]).as_matrix()
        pivot = np.median(wall, axis=0)
        moved = turn @ (centre[0] - pivot) + pivot - centre[0]
        turned = Rotation.from_matrix(rotation[0].T @ turn @ rotation[0]).as_rotvec()
        draws.append([*moved, *turned])
    expected = np.cov(np.array(draws).T)
    scale = np.sqrt(np.diag(expected) + 1e-8)
    np.testing.assert_allclose(found / np.outer(scale, scale), expected / np.outer(scale, scale), rtol=0, atol=0.08)
    assert 0.07 < np.sqrt(found[2, 2]) < 0.09  # m: fifteen metres from a wall of twelve
