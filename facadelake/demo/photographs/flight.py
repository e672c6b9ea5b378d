"""Where the camera was: an orbit in waves of height, close rows before the facades, and what the aircraft believed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.demo.recipe import CampaignRecipe, DemoBuilding, Optics
from facadelake.demo.world import DemoWorld

EXPOSURE_INTERVAL_S = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class DemoExposure:
    """A photograph to be taken: its file, time, true camera, and the tags with the aircraft's errors."""

    file_name: str
    taken_at: datetime
    posed: PosedCamera
    tag_lon_lat_height: Float64Array
    tag_yaw_pitch_roll_deg: Float64Array


def camera_from_optics(optics: Optics) -> Camera:
    """The true camera."""
    keys = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2")
    return Camera(**{k: getattr(optics, k) for k in keys})


def rotation_from_yaw_pitch_roll(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Float64Array:
    """``site_from_cam`` rotation (3, 3): yaw clockwise from north, pitch up from level, roll right side down."""
    y, p, r = np.radians([yaw_deg, pitch_deg, roll_deg])
    forward = np.array([np.sin(y) * np.cos(p), np.cos(y) * np.cos(p), np.sin(p)])
    right = np.array([np.cos(y), -np.sin(y), 0.0])
    down = np.cross(forward, right)
    return np.column_stack([np.cos(r) * right + np.sin(r) * down, np.cos(r) * down - np.sin(r) * right, forward])


def _locate_on_orbit(b: DemoBuilding, distance: float, along_m: float) -> tuple[Float64Array, float]:
    """The plan point (2,) at a length along the outline ``distance`` outside the house, from the south-west corner
    anticlockwise round corners of that radius; and the outline's whole length."""
    corners = np.array([(b.length_m, 0.0), (b.length_m, b.depth_m), (0.0, b.depth_m), (0.0, 0.0)])
    arc = np.pi / 2 * distance
    sides = [b.length_m, b.depth_m, b.length_m, b.depth_m]
    total = sum(sides) + 4 * arc
    left = along_m % total
    for number, (corner, side) in enumerate(zip(corners, sides, strict=True)):
        angle = (number - 1) * np.pi / 2
        out = np.array([np.cos(angle), np.sin(angle)])
        if left <= side:
            return corner + distance * out - (side - left) * np.array([-out[1], out[0]]), total
        if left <= side + arc:
            turned = angle + (left - side) / distance
            return corner + distance * np.array([np.cos(turned), np.sin(turned)]), total
        left -= side + arc
    raise AssertionError("a length within the outline lies on one of its pieces")


def _plan_orbit(
    b: DemoBuilding, count: int, distance: float, heights: list[float]
) -> list[tuple[Float64Array, Float64Array]]:
    """Positions and aims (model frame) round the house, twice as dense round its corners as along its sides.

    Round a corner the facades turn away fast, and SIFT does not follow a turn of more than 20 degrees. Aims lie on
    a short line through the middle of the house, so that the view turns steadily.
    """
    _, total = _locate_on_orbit(b, distance, 0.0)
    fine = np.array([_locate_on_orbit(b, distance, s)[0] for s in np.linspace(0, total, 2000)])
    plan = np.array([b.length_m, b.depth_m])
    at_corner = np.all((fine < 0) | (fine > plan), axis=1)
    steps = np.linalg.norm(np.diff(fine, axis=0), axis=1) * np.where(at_corner[1:], 2.0, 1.0)
    weight = np.concatenate([[0.0], np.cumsum(steps)])
    stations = np.interp((np.arange(count) + 0.5) * weight[-1] / count, weight, np.arange(2000))
    result = []
    for i, station in enumerate(stations):
        x, y = fine[round(station)]
        height = heights[i % len(heights)]
        aim_x = np.clip(x, 0.3 * b.length_m, 0.7 * b.length_m)
        aim = np.array([aim_x, b.depth_m / 2, 0.45 * height + 0.26 * b.top_m])
        result.append((np.array([x, y, height]), aim))
    return result


def _plan_close_range_rows(world: DemoWorld, campaign: CampaignRecipe) -> list[tuple[Float64Array, Float64Array]]:
    """Positions and aims (model frame) of the close-range rows."""
    result = []
    for row in campaign.flight.close:
        chart = world.charts[row.surface]
        for u in np.linspace(row.u_from_m, row.u_to_m, row.count):
            at = np.array([float(u)])
            aim = chart.compute_points(at, np.array([row.v_m]))[0]
            out, along = chart.compute_normals(at)[0], chart.compute_tangent(float(u))
            turn = np.radians(row.turn_deg)
            result.append((aim + row.distance_m * (np.cos(turn) * out + np.sin(turn) * along), aim))
    return result


def plan_flight(
    world: DemoWorld, campaign: CampaignRecipe, geo_from_site: Callable[[Float64Array], Float64Array]
) -> list[DemoExposure]:
    """All photographs of a campaign in the order they were taken, ``multiview/`` first."""
    flight, rng = campaign.flight, np.random.default_rng([world.recipe.seed, campaign.seed])
    camera = camera_from_optics(world.recipe.optics)
    stops = [
        ("multiview", *s)
        for s in _plan_orbit(world.recipe.building, flight.orbit_count, flight.orbit_distance_m, flight.orbit_heights_m)
    ]
    stops += [("closerange", *s) for s in _plan_close_range_rows(world, campaign)]
    starts = datetime.fromisoformat(campaign.starts)
    shots = []
    for number, (role, position_ifc, aim_ifc) in enumerate(stops, start=1):
        scale = flight.jitter_m if role == "multiview" else 0.5 * flight.jitter_m
        centre = world.transform_to_site(position_ifc) + rng.uniform(-scale, scale, 3)
        d = world.transform_to_site(aim_ifc) - centre
        aimed = np.array([np.degrees(np.arctan2(d[0], d[1])), np.degrees(np.arctan2(d[2], np.hypot(d[0], d[1]))), 0.0])
        true = aimed + rng.uniform(-flight.jitter_deg, flight.jitter_deg, 3) * [1, 1, 0.5]
        pose = Similarity(rotation=rotation_from_yaw_pitch_roll(*true.tolist()), translation=centre)
        believed = centre + flight.gps_bias_m + rng.normal(size=3) * flight.gps_noise_m
        attitude = true + flight.attitude_bias_deg + rng.normal(scale=flight.attitude_noise_deg, size=3)
        shots.append(
            DemoExposure(
                file_name=f"{role}/DJI_{number:04d}.JPG",
                taken_at=starts + timedelta(seconds=EXPOSURE_INTERVAL_S * number),
                posed=PosedCamera(camera=camera, site_from_cam=pose),
                tag_lon_lat_height=geo_from_site(believed[None])[0],
                tag_yaw_pitch_roll_deg=attitude,
            )
        )
    return shots
