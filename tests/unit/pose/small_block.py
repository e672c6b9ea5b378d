"""A block of known truth for the adjustment: a box of a building and the ground, seen by cameras around it.

Truth and images come from ``PosedCamera``, never from the adjustment's own projection.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.camera import Camera, PosedCamera
from facadelake.frames import Array, Similarity
from facadelake.pose.adjustment.linearise import State
from facadelake.pose.adjustment.model_terms import no_walls
from facadelake.pose.adjustment.problem import (
    AttitudeTerms,
    Block,
    NodePriors,
    PositionTerms,
    Problem,
    Rows,
    Sightings,
    WallTerms,
)
from facadelake.pose.adjustment.projection import LENS_TERMS, lens_of

CAMERA = Camera(width_px=4000, height_px=3000, fx_px=2900, fy_px=2900, cx_px=2000, cy_px=1500)
# Four facades of a box of 10 x 8 x 8 m and the ground around it: outward normals, and n . x of each plane.
NORMALS = np.array([[0.0, -1, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 1]])
PLANES_M = np.array([4.0, 5.0, 4.0, 5.0, 0.0])


def looking(at: Array, centre: Array) -> Array:
    """site_from_cam rotation (3, 3) of an upright camera."""
    z = (at - centre) / np.linalg.norm(at - centre)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


@dataclass(frozen=True, kw_only=True, eq=False)
class SmallBlock:
    """``cameras`` (n), ``xyz_m`` (m, 3) and the plane (m,) each point lies on, and what is seen: ``photo``, ``node``
    (k,) and ``xy_img`` (k, 2), without noise."""

    cameras: tuple[PosedCamera, ...]
    xyz_m: Array
    plane: Rows
    photo: Rows
    node: Rows
    xy_img: Array

    @property
    def centres_m(self) -> Array:
        """True centres (n, 3)."""
        return np.array([camera.centre_site_m for camera in self.cameras])

    @property
    def rotations(self) -> Array:
        """True site_from_cam (n, 3, 3)."""
        return np.array([camera.site_from_cam.rotation for camera in self.cameras])

    def errors(self, state: State) -> Array:
        """Camera errors (n, 6) of a state: centre in site (m), attitude about the camera's own axes (rad)."""
        turn = Rotation.from_matrix(self.rotations.transpose(0, 2, 1) @ state.site_from_cam).as_rotvec()
        return np.hstack([state.centre_site_m - self.centres_m, turn])


def small_block(
    photographs: int = 12, points: int = 200, camera: Camera = CAMERA, longest_track: int | None = None
) -> SmallBlock:
    """Cameras all around the box at three heights, every other one upright; ``longest_track`` keeps tracks short."""
    rng = np.random.default_rng(12)
    posed = []
    for k, angle in enumerate(np.linspace(0, 2 * np.pi, photographs, endpoint=False)):
        centre = np.array([17 * np.cos(angle), 16 * np.sin(angle), (2.5, 5.5, 9.0)[k % 3]])
        at = np.array([0.0, 0.0, 3.5]) + rng.uniform(-1, 1, 3)
        roll = Rotation.from_euler("z", 90.0 * (k % 2), degrees=True).as_matrix()
        posed.append(
            PosedCamera(
                camera=camera, site_from_cam=Similarity(rotation=looking(at, centre) @ roll, translation=centre)
            )
        )
    plane = np.arange(points) % 5
    along, up = rng.uniform(-1, 1, points), rng.uniform(0, 8, points)
    turn = 2 * np.pi * along
    xyz = np.select(
        [(plane == side)[:, None] for side in range(4)],
        [
            np.column_stack([5 * along, np.full(points, -4.0), up]),
            np.column_stack([np.full(points, 5.0), 4 * along, up]),
            np.column_stack([5 * along, np.full(points, 4.0), up]),
            np.column_stack([np.full(points, -5.0), 4 * along, up]),
        ],
        np.column_stack([(6 + 0.4 * up) * np.cos(turn), (5.5 + 0.4 * up) * np.sin(turn), 0 * up]),
    )
    photo, node, xy = [], [], []
    for k, camera_of_it in enumerate(posed):
        pixel = camera_of_it.project_site(xyz)
        hidden = (plane == 4) & ((xyz[:, :2] / [5, 4]) @ (camera_of_it.centre_site_m[:2] / [5, 4]) < 0)
        facing = (NORMALS[plane] @ camera_of_it.centre_site_m > PLANES_M[plane] + 1.0) & ~hidden
        seen = np.flatnonzero(facing & np.isfinite(pixel[:, 0]) & camera.contains(pixel))
        photo.append(np.full(len(seen), k))
        node.append(seen)
        xy.append(pixel[seen])
    photos, nodes, pixels = np.concatenate(photo), np.concatenate(node), np.vstack(xy)
    if longest_track is not None:
        order = np.lexsort((rng.uniform(size=len(nodes)), nodes))
        rank = np.empty(len(nodes), dtype=np.int64)
        rank[order] = np.arange(len(nodes)) - np.searchsorted(nodes[order], nodes[order])
        kept = rank < longest_track
        photos, nodes, pixels = photos[kept], nodes[kept], pixels[kept]
    enough = np.bincount(nodes, minlength=points)[nodes] >= 2
    photos, nodes, pixels = photos[enough], nodes[enough], pixels[enough]
    used, nodes = np.unique(nodes, return_inverse=True)
    return SmallBlock(
        cameras=tuple(posed), xyz_m=xyz[used], plane=plane[used], photo=photos, node=nodes.ravel(), xy_img=pixels
    )


def ties_problem(
    block: SmallBlock,
    rng: np.random.Generator,
    *,
    tie_px: float,
    start_m: float = 0.05,
    start_deg: float = 0.3,
    lens: Camera | None = None,
) -> Problem:
    """Tie points with ``tie_px`` of noise and a perturbed start; nothing fixes the datum yet. The lens starts at
    ``lens`` (or the truth), known beforehand to a percent."""
    begin = block.cameras[0].camera if lens is None else lens
    n, k = len(block.cameras), len(block.photo)
    sigma = np.array([0.01 * begin.fx_px, 0.002, 30.0, 30.0, 0.05, 0.05, 0.005, 0.005])
    return Problem(
        block=Block(
            cameras=(begin,),
            camera_of_photo=np.zeros(n, dtype=np.int64),
            centre_site_m=block.centres_m + rng.normal(0, start_m, (n, 3)),
            site_from_cam=block.rotations
            @ Rotation.from_rotvec(rng.normal(0, np.radians(start_deg), (n, 3))).as_matrix(),
        ),
        node_xyz_m=block.xyz_m + rng.normal(0, start_m, block.xyz_m.shape),
        sightings=Sightings(
            photo=block.photo,
            node=block.node,
            offset_site_m=np.zeros((k, 3)),
            xy_img=block.xy_img + rng.normal(0, tie_px, (k, 2)),
            whitening=np.broadcast_to(np.eye(2), (k, 2, 2)).copy(),
            tie=np.ones(k, dtype=bool),
        ),
        node_priors=NodePriors(
            node=np.zeros(0, dtype=np.int64), xyz_m=np.zeros((0, 3)), information=np.zeros((0, 3, 3)), limit=np.zeros(0)
        ),
        walls=no_walls(),
        positions=PositionTerms(
            photo=np.zeros(0, dtype=np.int64), flight=np.zeros(0, dtype=np.int64), xyz_site_m=np.zeros((0, 3)),
            sigma_m=np.zeros((0, 3)), offset_sigma_m=np.zeros((0, 3)),
        ),
        attitudes=AttitudeTerms(
            photo=np.zeros(0, dtype=np.int64), flight=np.zeros(0, dtype=np.int64), site_from_cam=np.zeros((0, 3, 3)),
            sigma_rad=np.zeros((0, 3)), yaw_sigma_rad=np.zeros(0),
        ),
        lens_mean=lens_of(begin)[None],
        lens_sigma=sigma[None],
    )  # fmt: skip


def with_control(
    problem: Problem, block: SmallBlock, rng: np.random.Generator, *, nodes: Rows, sigma_m: float
) -> Problem:
    """Some tie points surveyed within ``sigma_m``."""
    k = len(nodes)
    return replace(
        problem,
        node_priors=NodePriors(
            node=nodes,
            xyz_m=block.xyz_m[nodes] + rng.normal(0, sigma_m, (k, 3)),
            information=np.broadcast_to(np.eye(3) / sigma_m**2, (k, 3, 3)).copy(),
            limit=np.full(k, 4.0),
        ),
    )


def with_gps(
    problem: Problem,
    block: SmallBlock,
    rng: np.random.Generator,
    *,
    noise_m: float,
    bias_m: Sequence[Array],
    bias_sigma_m: float,
) -> Problem:
    """GPS of as many flights as there are biases, photographs in turn."""
    n, flights = len(block.cameras), len(bias_m)
    flight = np.arange(n) % flights
    return replace(
        problem,
        positions=PositionTerms(
            photo=np.arange(n),
            flight=flight,
            xyz_site_m=block.centres_m + np.array(bias_m)[flight] + rng.normal(0, noise_m, (n, 3)),
            sigma_m=np.full((n, 3), noise_m),
            offset_sigma_m=np.full((flights, 3), bias_sigma_m),
        ),
    )


def with_walls(
    problem: Problem,
    block: SmallBlock,
    rng: np.random.Generator,
    *,
    relief_m: float,
    wall_m: Array,
    wall_sigma_m: float,
) -> Problem:
    """Every tie point lies on its plane of the model, which stands off the building by ``wall_m`` (5,) and relief."""
    m = len(block.xyz_m)
    return replace(
        problem,
        walls=WallTerms(
            node=np.arange(m),
            normal_site=NORMALS[block.plane],
            distance_m=PLANES_M[block.plane] - np.asarray(wall_m)[block.plane] + rng.normal(0, relief_m, m),
            wall=block.plane,
            sigma_m=np.full(m, relief_m),
            wall_sigma_m=np.full(len(NORMALS), wall_sigma_m),
        ),
    )


def holding_lens(problem: Problem, *terms: str) -> Problem:
    """The problem with lens ``terms`` (all, where none is named) held at their mean."""
    held = np.isin(LENS_TERMS, terms) if terms else np.ones(len(LENS_TERMS), dtype=bool)
    return replace(problem, lens_sigma=np.where(held, 0.0, problem.lens_sigma))
