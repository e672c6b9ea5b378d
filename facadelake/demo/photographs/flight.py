"""The flight: true camera poses of an orbit and of close-range rows, and tags with the errors of the aircraft."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from facadelake.core.arrays import Float64Nx3, Float64x2, Float64x3, Float64x3x3
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.demo.recipe import CampaignRecipe, DemoBuilding, DemoFlight, Optics
from facadelake.demo.world import DemoWorld

EXPOSURE_INTERVAL_S = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class DemoExposure:
    """A photograph to be taken: file, time, true camera, and tags with the errors of the aircraft."""

    file_name: str
    taken_at: datetime
    posed: PosedCamera
    tag_lon_lat_height: Float64x3
    tag_yaw_pitch_roll_deg: Float64x3


def camera_from_optics(optics: Optics) -> Camera:
    """The true camera."""
    keys = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2")
    return Camera(**{k: getattr(optics, k) for k in keys})


def rotation_from_yaw_pitch_roll(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Float64x3x3:
    """``site_from_cam`` rotation (3, 3): yaw clockwise from north, pitch up from level, roll right side down."""
    y, p, r = np.radians([yaw_deg, pitch_deg, roll_deg])
    forward = np.array([np.sin(y) * np.cos(p), np.cos(y) * np.cos(p), np.sin(p)])
    right = np.array([np.cos(y), -np.sin(y), 0.0])
    down = np.cross(forward, right)
    return np.column_stack([np.cos(r) * right + np.sin(r) * down, np.cos(r) * down - np.sin(r) * right, forward])


def _locate_on_orbit(b: DemoBuilding, distance: float, along_m: float) -> tuple[Float64x2, float]:
    """The plan point (2,) at a length along the orbit, and the length of the whole orbit.

    The orbit is the outline at ``distance`` outside the building, from the south-west corner anticlockwise, with
    corners rounded by that radius.
    """
    corners = np.array([(b.length_m, 0.0), (b.length_m, b.depth_m), (0.0, b.depth_m), (0.0, 0.0)])
    arc = np.pi / 2 * distance
    sides = [b.length_m, b.depth_m, b.length_m, b.depth_m]
    total = sum(sides) + 4 * arc
    remaining = along_m % total
    for number, (corner, side) in enumerate(zip(corners, sides, strict=True)):
        angle = (number - 1) * np.pi / 2
        outward = np.array([np.cos(angle), np.sin(angle)])
        if remaining <= side:
            return corner + distance * outward - (side - remaining) * np.array([-outward[1], outward[0]]), total
        if remaining <= side + arc:
            arc_angle = angle + (remaining - side) / distance
            return corner + distance * np.array([np.cos(arc_angle), np.sin(arc_angle)]), total
        remaining -= side + arc
    raise AssertionError("every length within the orbit is on one of its sections")


def _plan_orbit(b: DemoBuilding, flight: DemoFlight) -> list[tuple[Float64x3, Float64x3]]:
    """Positions and aims (model frame) around the building, twice as dense around its corners as along its sides.

    Around a corner the facades turn away fast, and SIFT does not match across a rotation of more than 20 degrees. The
    aims are on a short line through the middle of the building, so that the view rotates steadily.
    """
    count, distance, heights = flight.orbit_count, flight.orbit_distance_m, flight.orbit_heights_m
    _, total = _locate_on_orbit(b, distance, 0.0)
    outline = np.array([_locate_on_orbit(b, distance, s)[0] for s in np.linspace(0, total, 2000)])
    plan_size = np.array([b.length_m, b.depth_m])
    at_corner = np.all((outline < 0) | (outline > plan_size), axis=1)
    steps = np.linalg.norm(np.diff(outline, axis=0), axis=1) * np.where(at_corner[1:], 2.0, 1.0)
    weight = np.concatenate([[0.0], np.cumsum(steps)])
    stations = np.interp((np.arange(count) + 0.5) * weight[-1] / count, weight, np.arange(2000))
    result = []
    for i, station in enumerate(stations[: flight.count_orbit_photographs()]):
        x, y = outline[round(station)]
        height = heights[i % len(heights)]
        aim_x = np.clip(x, 0.3 * b.length_m, 0.7 * b.length_m)
        aim = np.array([aim_x, b.depth_m / 2, 0.45 * height + 0.26 * b.top_m])
        result.append((np.array([x, y, height]), aim))
    return result


def _plan_close_range_rows(world: DemoWorld, campaign: CampaignRecipe) -> list[tuple[Float64x3, Float64x3]]:
    """Positions and aims (model frame) of the close-range rows."""
    result = []
    for row in campaign.flight.close:
        chart = world.charts[row.surface]
        for u in np.linspace(row.u_from_m, row.u_to_m, row.count):
            at = np.array([float(u)])
            aim = chart.compute_points(at, np.array([row.v_m]))[0]
            outward, along = chart.compute_normals(at)[0], chart.compute_tangent(float(u))
            turn_rad = np.radians(row.turn_deg)
            result.append((aim + row.distance_m * (np.cos(turn_rad) * outward + np.sin(turn_rad) * along), aim))
    return result


def plan_flight(
    world: DemoWorld, campaign: CampaignRecipe, geo_from_site: Callable[[Float64Nx3], Float64Nx3]
) -> list[DemoExposure]:
    """All photographs of a campaign in the order in which they are taken, ``multiview/`` first."""
    flight, rng = campaign.flight, np.random.default_rng([world.recipe.seed, campaign.seed])
    camera = camera_from_optics(world.recipe.find_optics(campaign))
    stops = [("multiview", *s) for s in _plan_orbit(world.recipe.building, flight)]
    stops += [("closerange", *s) for s in _plan_close_range_rows(world, campaign)]
    starts = datetime.fromisoformat(campaign.starts)
    exposures = []
    for number, (role, position_ifc, aim_ifc) in enumerate(stops, start=1):
        scale = flight.jitter_m if role == "multiview" else 0.5 * flight.jitter_m
        centre = world.transform_to_site(position_ifc) + rng.uniform(-scale, scale, 3)
        view = world.transform_to_site(aim_ifc) - centre
        yaw_rad, pitch_rad = np.arctan2(view[0], view[1]), np.arctan2(view[2], np.hypot(view[0], view[1]))
        planned_deg = np.array([np.degrees(yaw_rad), np.degrees(pitch_rad), 0.0])
        true_deg = planned_deg + rng.uniform(-flight.jitter_deg, flight.jitter_deg, 3) * [1, 1, 0.5]
        pose = Similarity(rotation=rotation_from_yaw_pitch_roll(*true_deg.tolist()), translation=centre)
        tag_position = centre + flight.gps_bias_m + rng.normal(size=3) * flight.gps_noise_m
        tag_attitude_deg = true_deg + flight.attitude_bias_deg + rng.normal(scale=flight.attitude_noise_deg, size=3)
        exposures.append(
            DemoExposure(
                file_name=f"{role}/DJI_{number:04d}.JPG",
                taken_at=starts + timedelta(seconds=EXPOSURE_INTERVAL_S * number),
                posed=PosedCamera(camera=camera, site_from_cam=pose),
                tag_lon_lat_height=geo_from_site(tag_position[None])[0],
                tag_yaw_pitch_roll_deg=tag_attitude_deg,
            )
        )
    return exposures
