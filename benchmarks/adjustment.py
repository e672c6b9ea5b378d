"""Time, memory and error of the georeferenced adjustment by number of photographs, on a synthetic flight with GPS.

    .venv/bin/python -m benchmarks.adjustment 100 300 1000

The block is the flight of ``synthetic_block`` as after COLMAP's mapping: image points with noise of 0.5 px, cameras
with errors of 2 cm and 0.05 deg (one sigma, each axis). GPS positions have a common offset of metres and noise of
0.5 m. Prints Markdown; each size runs in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any

import numpy as np
import psutil
from scipy.spatial.transform import Rotation

from benchmarks.scale import ROOT, CostMeter
from benchmarks.synthetic_block import (
    DETECTED_SHARE,
    HEIGHT_PX,
    KEYPOINT_NOISE_PX,
    STAND_OFF_M,
    TRUE_PARAMS,
    WIDTH_PX,
    Flight,
    generate_flight,
)
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.adjust import adjust_block
from facadelake.georeferencing.adjustment.control_observations import ControlObservations
from facadelake.georeferencing.adjustment.problem import AttitudeTerms, PositionTerms
from facadelake.sfm import Reconstruction
from facadelake.sfm.reconstruction import LocalisedPhoto

_PER_PHOTO = 1500
_GPS_OFFSET_M = np.array([1.5, -0.8, 2.0])
_GPS_NOISE_M = 0.5
_NAMES = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2")


def generate_block(flight: Flight, rng: np.random.Generator) -> Reconstruction:
    """The flight's photographs and tie points as after mapping; frame ``sfm`` is the flight's world frame."""
    camera = Camera(width_px=WIDTH_PX, height_px=HEIGHT_PX, **dict(zip(_NAMES, TRUE_PARAMS, strict=True)))
    seen_area_m2 = WIDTH_PX * HEIGHT_PX / camera.fx_px**2 * STAND_OFF_M**2
    house = flight.house
    count = int(_PER_PHOTO / DETECTED_SHARE / seen_area_m2 * house.outline_m * house.height_m)
    xyz, normal = house.sample_points(count, rng)
    photos, track_photo, track_point, track_xy = [], [], [], []
    for k, (centre, rotation) in enumerate(zip(flight.centres_m, flight.rotations, strict=True)):
        posed = PosedCamera(camera=camera, site_from_cam=Similarity(rotation=rotation, translation=centre))
        near = np.flatnonzero((np.linalg.norm(xyz - centre, axis=1) < 25) & (((centre - xyz) * normal).sum(axis=1) > 1))
        xy = posed.project_site(xyz[near]) + rng.normal(0, KEYPOINT_NOISE_PX, (len(near), 2))
        kept = np.isfinite(xy).all(axis=1) & camera.is_inside(xy) & (rng.random(len(near)) < DETECTED_SHARE)
        track_photo.append(np.full(int(kept.sum()), k))
        track_point.append(near[kept])
        track_xy.append(xy[kept])
        rotation_error = Rotation.from_rotvec(np.radians(rng.normal(0, 0.05, 3))).as_matrix()
        photos.append(
            LocalisedPhoto(
                photo_id=f"{k:05d}.jpg",
                camera=camera,
                sfm_from_cam=Similarity(
                    rotation=rotation @ rotation_error, translation=centre + rng.normal(0, 0.02, 3)
                ),
                reprojection_error_px=KEYPOINT_NOISE_PX,
                tie_points=int(kept.sum()),
            )
        )
    point = np.concatenate(track_point)
    often = np.flatnonzero(np.bincount(point, minlength=len(xyz)) >= 3)
    row = np.full(len(xyz), -1)
    row[often] = np.arange(len(often))
    kept = row[point] >= 0
    return Reconstruction(
        photos=tuple(photos),
        unlocalised=(),
        xyz_sfm=xyz[often] + rng.normal(0, 0.02, (len(often), 3)),
        rgb=np.zeros((len(often), 3), dtype=np.uint8),
        image_point_photo=np.concatenate(track_photo)[kept],
        image_point_tie_point=row[point[kept]],
        image_point_xy_img=np.vstack(track_xy)[kept],
        mean_reprojection_error_px=KEYPOINT_NOISE_PX,
        costs=(),
    )


def measure(count: int) -> dict[str, Any]:
    """Adjust a flight of ``count`` photographs in this process; its figures by name."""
    rng = np.random.default_rng(7)
    flight = generate_flight(count, rng)
    reconstruction = generate_block(flight, rng)
    rows, one = np.arange(count), np.zeros(count, dtype=np.int64)
    positions = PositionTerms(
        photo=rows,
        flight=one,
        xyz_site_m=flight.centres_m + _GPS_OFFSET_M + rng.normal(0, _GPS_NOISE_M, (count, 3)),
        sigma_m=np.full((count, 3), _GPS_NOISE_M),
        offset_sigma_m=np.full((1, 3), 3.0),
    )
    attitudes = AttitudeTerms(
        photo=rows[:0],
        flight=one[:0],
        site_from_cam=np.zeros((0, 3, 3)),
        sigma_rad=np.zeros((0, 3)),
        yaw_sigma_rad=np.zeros(0),
    )
    identity = Similarity(rotation=np.eye(3), translation=np.zeros(3))
    before_mb = psutil.Process().memory_info().rss / 2**20
    cost = CostMeter()
    adjusted = adjust_block(reconstruction, identity, ControlObservations(positions=positions, attitudes=attitudes))
    spent = cost.read()
    error = np.array([c.centre_site_m for c in adjusted.cameras]) - flight.centres_m
    # GPS cannot determine the flight's common offset; the rest is the error of the block's shape.
    shape = error - error.mean(axis=0)
    inside = np.einsum("ni,nij,nj->n", error, np.linalg.inv(adjusted.covariance[:, :3, :3]), error) < 7.81
    return {
        **spent,
        "before_mb": before_mb,
        "tie_points": len(adjusted.tie_points.reconstruction_point),
        "image_points": len(adjusted.tie_points.photo),
        "steps": adjusted.solution.iterations,
        "common_m": float(np.linalg.norm(error.mean(axis=0))),
        "shape_m": float(np.linalg.norm(shape, axis=1).mean()),
        "inside": float(inside.mean()),
    }


def main() -> None:
    """Print a row for each number of photographs on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("counts", nargs="+", type=int, help="numbers of photographs")
    counts = parser.parse_args().counts
    gib = psutil.virtual_memory().total / 2**30
    print(f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, {psutil.cpu_count()} cores, {gib:.0f} GiB, load "
          f"{os.getloadavg()[0]:.1f} before, Python {platform.python_version()}\n")  # fmt: skip
    print("| photographs | tie points | image points | wall s | CPU s | peak MB | common error m | shape error cm | "
          "inside 2 sigma |\n|---|---|---|---|---|---|---|---|---|")  # fmt: skip
    done = []
    for count in counts:
        code = f"import json; from benchmarks import adjustment; print(json.dumps(adjustment.measure({count})))"
        ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
        if ran.returncode:
            raise SystemExit(f"{count} photographs failed:\n{ran.stderr}")
        found = json.loads(ran.stdout.splitlines()[-1])
        done.append((count, found["cpu_s"]))
        cells = [count, found["tie_points"], found["image_points"], f"{found['wall_s']:.0f}", f"{found['cpu_s']:.0f}",
                 f"{found['peak_mb']:.0f}", f"{found['common_m']:.2f}", f"{found['shape_m'] * 100:.2f}",
                 f"{found['inside']:.2f}"]  # fmt: skip
        print(f"| {' | '.join(map(str, cells))} |", flush=True)
    for first, second in pairwise(done):
        slope = np.log(second[1] / first[1]) / np.log(second[0] / first[0])
        print(f"\nFrom {first[0]} to {second[0]}: CPU time grows as n^{slope:.2f}.")


if __name__ == "__main__":
    main()
