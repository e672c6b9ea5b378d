"""A block of known truth for the adjustment: a box of a building and the ground, seen by cameras around it.

Truth and images come from ``PosedCamera``, never from the adjustment's own projection.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import Float64Array, RowIndices
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.control_observations import MarkedPoints
from facadelake.georeferencing.adjustment.parameters import AdjustmentState
from facadelake.georeferencing.adjustment.point_to_plane import build_empty_terms
from facadelake.georeferencing.adjustment.problem import (
    AdjustmentProblem,
    AttitudeTerms,
    Block,
    ImagePoints,
    PointPriors,
    PointToPlaneTerms,
    PositionTerms,
)
from facadelake.georeferencing.adjustment.projection import LENS_PARAMETERS, lens_from_camera
from facadelake.sfm.reconstruction import LocalisedPhoto, Reconstruction

CAMERA = Camera(width_px=4000, height_px=3000, fx_px=2900, fy_px=2900, cx_px=2000, cy_px=1500)
# Four facades of a box of 10 x 8 x 8 m and the ground around it: outward normals, and n . x of each plane.
NORMALS = np.array([[0.0, -1, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 1]])
PLANES_M = np.array([4.0, 5.0, 4.0, 5.0, 0.0])


def rotation_from_target(at: Float64Array, centre: Float64Array) -> Float64Array:
    """site_from_cam rotation (3, 3) of an upright camera."""
    z = (at - centre) / np.linalg.norm(at - centre)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


@dataclass(frozen=True, kw_only=True, eq=False)
class SmallBlock:
    """``cameras`` (n), ``xyz_m`` (m, 3) and the plane (m,) each point lies on, and what is seen: ``photo``, ``point``
    (k,) and ``xy_img`` (k, 2), without noise."""

    cameras: tuple[PosedCamera, ...]
    xyz_m: Float64Array
    plane: RowIndices
    photo: RowIndices
    point: RowIndices
    xy_img: Float64Array

    @property
    def centres_m(self) -> Float64Array:
        """True centres (n, 3)."""
        return np.array([camera.centre_site_m for camera in self.cameras])

    @property
    def rotations(self) -> Float64Array:
        """True site_from_cam (n, 3, 3)."""
        return np.array([camera.site_from_cam.rotation for camera in self.cameras])

    def errors(self, state: AdjustmentState) -> Float64Array:
        """Camera errors (n, 6) of a state: centre in site (m), attitude about the camera's own axes (rad)."""
        turn = Rotation.from_matrix(self.rotations.transpose(0, 2, 1) @ state.site_from_cam).as_rotvec()
        return np.hstack([state.centre_site_m - self.centres_m, turn])


@dataclass(frozen=True, kw_only=True)
class Hits:
    """What a ray met: the face's number as element (0 south, 1 east, 2 north, 3 west, 4 ground), -1 for none."""

    distance_m: Float64Array
    normal_site: Float64Array
    element: RowIndices


@dataclass(frozen=True, kw_only=True)
class BoxSurface:
    """A box's walls, of half sides ``half_m`` about the site's origin and ``height_m`` high, and a flat ground around
    it where there is one: cut by rays analytically."""

    half_m: tuple[float, float] = (5.0, 4.0)
    height_m: float = 8.0
    ground: bool = True

    def cast(self, origins_site_m: Float64Array, directions_site: Float64Array, /) -> Hits:
        """First hits from outside."""
        high = np.array([*self.half_m, self.height_m])
        low = np.array([-self.half_m[0], -self.half_m[1], 0.0])
        with np.errstate(divide="ignore", invalid="ignore"):
            enter = np.where(directions_site > 0, low - origins_site_m, high - origins_site_m) / directions_site
            leave = np.where(directions_site > 0, high - origins_site_m, low - origins_site_m) / directions_site
            down = np.where(directions_site[:, 2] < 0, -origins_site_m[:, 2] / directions_site[:, 2], np.inf)
        axis = np.argmax(enter, axis=1)
        near = enter.max(axis=1)
        near[(near > leave.min(axis=1)) | (near < 0)] = np.inf
        into = directions_site[np.arange(len(axis)), axis] > 0
        element = np.select([axis == 0, axis == 1], [np.where(into, 3, 1), np.where(into, 0, 2)], 5)
        normal = np.eye(3)[axis] * np.where(into, -1.0, 1.0)[:, None]
        if self.ground:
            first = down < near
            element[first], normal[first] = 4, [0.0, 0.0, 1.0]
            near = np.minimum(near, down)
        met = np.isfinite(near)
        return Hits(
            distance_m=near, normal_site=np.where(met[:, None], normal, np.nan), element=np.where(met, element, -1)
        )


def build_small_block(
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
                camera=camera,
                site_from_cam=Similarity(rotation=rotation_from_target(at, centre) @ roll, translation=centre),
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
        seen = np.flatnonzero(facing & np.isfinite(pixel[:, 0]) & camera.is_inside(pixel))
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
        cameras=tuple(posed), xyz_m=xyz[used], plane=plane[used], photo=photos, point=nodes.ravel(), xy_img=pixels
    )


def build_no_positions() -> PositionTerms:
    """No GPS."""
    none, empty = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    return PositionTerms(photo=none, flight=none, xyz_site_m=empty, sigma_m=empty, offset_sigma_m=empty)


def build_no_attitudes() -> AttitudeTerms:
    """No gimbal."""
    none = np.zeros(0, dtype=np.int64)
    return AttitudeTerms(
        photo=none,
        flight=none,
        site_from_cam=np.zeros((0, 3, 3)),
        sigma_rad=np.zeros((0, 3)),
        yaw_sigma_rad=np.zeros(0),
    )


def build_tie_point_problem(
    block: SmallBlock,
    rng: np.random.Generator,
    *,
    tie_px: float,
    start_m: float = 0.05,
    start_deg: float = 0.3,
    lens: Camera | None = None,
) -> AdjustmentProblem:
    """Tie points with ``tie_px`` of noise and a perturbed start; nothing fixes the datum yet. The lens starts at
    ``lens`` (or the truth), known beforehand to a percent."""
    begin = block.cameras[0].camera if lens is None else lens
    n, k = len(block.cameras), len(block.photo)
    sigma = np.array([0.01 * begin.fx_px, 0.002, 30.0, 30.0, 0.05, 0.05, 0.005, 0.005])
    return AdjustmentProblem(
        block=Block(
            cameras=(begin,),
            camera_of_photo=np.zeros(n, dtype=np.int64),
            centre_site_m=block.centres_m + rng.normal(0, start_m, (n, 3)),
            site_from_cam=block.rotations
            @ Rotation.from_rotvec(rng.normal(0, np.radians(start_deg), (n, 3))).as_matrix(),
        ),
        initial_xyz_m=block.xyz_m + rng.normal(0, start_m, block.xyz_m.shape),
        image_points=ImagePoints(
            photo=block.photo,
            point=block.point,
            xy_img=block.xy_img + rng.normal(0, tie_px, (k, 2)),
            whitening=np.broadcast_to(np.eye(2), (k, 2, 2)).copy(),
            is_tie_point=np.ones(k, dtype=bool),
        ),
        point_priors=PointPriors(
            point=np.zeros(0, dtype=np.int64),
            xyz_m=np.zeros((0, 3)),
            information=np.zeros((0, 3, 3)),
            loss_scale=np.zeros(0),
        ),
        point_to_plane=build_empty_terms(),
        positions=build_no_positions(),
        attitudes=build_no_attitudes(),
        lens_prior_mean=lens_from_camera(begin)[None],
        lens_prior_sigma=sigma[None],
    )


def add_control(
    problem: AdjustmentProblem, block: SmallBlock, rng: np.random.Generator, *, nodes: RowIndices, sigma_m: float
) -> AdjustmentProblem:
    """Some tie points surveyed within ``sigma_m``."""
    k = len(nodes)
    return replace(
        problem,
        point_priors=PointPriors(
            point=nodes,
            xyz_m=block.xyz_m[nodes] + rng.normal(0, sigma_m, (k, 3)),
            information=np.broadcast_to(np.eye(3) / sigma_m**2, (k, 3, 3)).copy(),
            loss_scale=np.full(k, 4.0),
        ),
    )


def add_gps(
    problem: AdjustmentProblem,
    block: SmallBlock,
    rng: np.random.Generator,
    *,
    noise_m: float,
    bias_m: Sequence[Float64Array],
    bias_sigma_m: float,
) -> AdjustmentProblem:
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


def add_walls(
    problem: AdjustmentProblem,
    block: SmallBlock,
    rng: np.random.Generator,
    *,
    relief_m: float,
    wall_deviation_m: Float64Array,
    wall_sigma_m: float,
) -> AdjustmentProblem:
    """Every tie point lies on its plane of the model, which deviates by ``wall_deviation_m`` (5,) and relief."""
    m = len(block.xyz_m)
    return replace(
        problem,
        point_to_plane=PointToPlaneTerms(
            point=np.arange(m),
            normal_site=NORMALS[block.plane],
            distance_m=PLANES_M[block.plane] - np.asarray(wall_deviation_m)[block.plane] + rng.normal(0, relief_m, m),
            wall=block.plane,
            sigma_m=np.full(m, relief_m),
            wall_sigma_m=np.full(len(NORMALS), wall_sigma_m),
        ),
    )


def fix_lens(problem: AdjustmentProblem, *terms: str) -> AdjustmentProblem:
    """The problem with lens ``terms`` (all, where none is named) held at their mean."""
    held = np.isin(LENS_PARAMETERS, terms) if terms else np.ones(len(LENS_PARAMETERS), dtype=bool)
    return replace(problem, lens_prior_sigma=np.where(held, 0.0, problem.lens_prior_sigma))


SITE_FROM_SFM = Similarity(
    rotation=Rotation.from_euler("xyz", [100, -35, 60], degrees=True).as_matrix(),
    translation=np.array([4.0, -2.0, 7.0]),
    scale=5.1,
)


def build_reconstruction(
    block: SmallBlock, rng: np.random.Generator, *, tie_px: float, lens: Camera | None = None, start_m: float = 0.02
) -> Reconstruction:
    """The block as structure from motion leaves it: tie points within ``tie_px``, places within ``start_m``, and the
    camera that it took it for, ``lens`` (the truth, if none)."""
    sfm_from_site = SITE_FROM_SFM.invert()
    moved = block.centres_m + rng.normal(0, start_m, block.centres_m.shape)
    return Reconstruction(
        photos=tuple(
            LocalisedPhoto(
                photo_id=f"p{k:02}.jpg",
                camera=camera.camera if lens is None else lens,
                sfm_from_cam=Similarity(
                    rotation=sfm_from_site.rotation @ camera.site_from_cam.rotation,
                    translation=sfm_from_site.apply(at),
                ),
                reprojection_error_px=tie_px,
                tie_points=int((block.photo == k).sum()),
            )
            for k, (camera, at) in enumerate(zip(block.cameras, moved, strict=True))
        ),
        unlocalised=(),
        xyz_sfm=sfm_from_site.apply(block.xyz_m + rng.normal(0, start_m, block.xyz_m.shape)),
        rgb=np.zeros((len(block.xyz_m), 3), dtype=np.uint8),
        image_point_photo=block.photo,
        image_point_tie_point=block.point,
        image_point_xy_img=block.xy_img + rng.normal(0, tie_px, block.xy_img.shape),
        mean_reprojection_error_px=tie_px,
        costs=(),
    )


def build_marked_points(
    block: SmallBlock, rng: np.random.Generator, *, points: RowIndices, survey_m: float, mark_px: float
) -> MarkedPoints:
    """Tie points surveyed within ``survey_m`` and marked again within ``mark_px`` wherever they are seen."""
    seen = np.flatnonzero(np.isin(block.point, points))
    k = len(points)
    return MarkedPoints(
        names=tuple(f"G{number}" for number in range(k)),
        xyz_site_m=block.xyz_m[points] + rng.normal(0, survey_m, (k, 3)),
        sigma_m=np.full((k, 3), survey_m),
        photo=block.photo[seen],
        point=np.searchsorted(points, block.point[seen]),
        xy_img=block.xy_img[seen] + rng.normal(0, mark_px, (len(seen), 2)),
        sigma_px=mark_px,
    )
