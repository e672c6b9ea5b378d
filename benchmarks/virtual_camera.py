"""Measure what it costs to register a photograph's detections, against rendering its whole depth at 48 Mpx.

    .venv/bin/python -m benchmarks.virtual_camera castle 2026-04 --lake lake

Both are measured in one run, on the portfolio's model and the committed poses and detections of a campaign. The
photograph's camera is kept, its pixels are made 8000 x 6000. Prints Markdown: wall time, and processor time (all
threads and children) for machines that do other work too; the median of several runs where one is short.
"""

from __future__ import annotations

import argparse
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import psutil
import pyarrow as pa
import pyarrow.compute as pc

from facadelake.building import BuildingModel, read_registered_model
from facadelake.building.surface import Surface
from facadelake.building.surface.virtual_view import write_scene
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.pose_table import read_pose_covariances, read_posed_cameras
from facadelake.lake import read_tables
from facadelake.registration import resolve_registration_settings
from facadelake.registration.observation import observe_detections
from facadelake.registration.raycast import cast_detections
from facadelake.registry import read_portfolio

ROOT = Path(__file__).resolve().parent.parent
HUGE = (8000, 6000)


@dataclass(frozen=True, kw_only=True)
class Cost:
    """Wall and processor seconds."""

    wall_s: float
    cpu_s: float


def _processor() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def cost_of(run: Callable[[], object], times: int) -> Cost:
    """Median over ``times`` runs, after one that is not counted where there are several."""
    if times > 1:
        run()
    walls, cpus = [], []
    for _ in range(times):
        wall, cpu = time.perf_counter(), _processor()
        run()
        walls.append(time.perf_counter() - wall)
        cpus.append(_processor() - cpu)
    return Cost(wall_s=float(np.median(walls)), cpu_s=float(np.median(cpus)))


def enlarged(posed: PosedCamera) -> PosedCamera:
    """The same camera with 8000 x 6000 pixels."""
    camera = posed.camera
    across, down = HUGE[0] / camera.width_px, HUGE[1] / camera.height_px
    return PosedCamera(
        camera=Camera(
            width_px=HUGE[0], height_px=HUGE[1],
            fx_px=camera.fx_px * across, fy_px=camera.fy_px * down,
            cx_px=camera.cx_px * across, cy_px=camera.cy_px * down,
            k1=camera.k1, k2=camera.k2, p1=camera.p1, p2=camera.p2,
        ),
        site_from_cam=posed.site_from_cam,
    )  # fmt: skip


def enlarged_boxes(detections: pa.Table, posed: PosedCamera) -> pa.Table:
    """Boxes at the same places of the enlarged photograph; outlines of masks are left out."""
    across, down = HUGE[0] / posed.camera.width_px, HUGE[1] / posed.camera.height_px
    for name, factor in (("x", across), ("y", down), ("width", across), ("height", down)):
        column = f"box_{name}_px"
        at = detections.column_names.index(column)
        detections = detections.set_column(
            at, detections.schema.field(column), pc.multiply(detections.column(column), factor)
        )
    at = detections.column_names.index("mask")
    return detections.set_column(at, detections.schema.field("mask"), pa.nulls(len(detections), pa.string()))


def rendering(model: BuildingModel, posed: PosedCamera) -> tuple[Cost, Cost]:
    """One depth image by pyrender: its pass alone in a process that stands ready, and all of it, process and scene."""
    straight = replace(posed, camera=replace(posed.camera, k1=0.0, k2=0.0, p1=0.0, p2=0.0))
    with tempfile.TemporaryDirectory(prefix="facadelake-benchmark-") as folder:
        lines: list[str] = []

        def run() -> None:
            write_scene(Path(folder), model, straight, *HUGE)
            done = subprocess.run(
                [sys.executable, "-m", "benchmarks.virtual_camera", "--render", folder],
                capture_output=True, text=True, check=True, cwd=ROOT, env={**os.environ, "PYOPENGL_PLATFORM": "egl"},
            )  # fmt: skip
            lines.append(done.stdout.splitlines()[-1])

        whole = cost_of(run, 1)
    wall, cpu = (float(value) for value in lines[-1].split())
    return Cost(wall_s=wall, cpu_s=cpu), whole


def render_ready(folder: Path) -> None:
    """The renderer's own process: print wall and processor seconds of the second depth image."""
    from facadelake.building.surface.render_worker import RenderView

    view = RenderView(folder)
    cost = cost_of(view.render_depth_buffer, 2)
    print(cost.wall_s, cost.cpu_s)


def measure(building_id: str, campaign: str, lake: Path, portfolio: Path) -> None:
    """Print the table."""
    building = read_portfolio(portfolio).get_building(building_id)
    model, settings = read_registered_model(building), resolve_registration_settings(building)
    tables = read_tables(lake, ["poses", "detections"], building_id=building_id, campaign_id=campaign)
    cameras, covariances = read_posed_cameras(tables["poses"]), read_pose_covariances(tables["poses"])
    found = tables["detections"].filter(pc.equal(tables["detections"].column("detection_outcome"), "accepted"))
    found = found.filter(pc.is_in(found.column("photo_id"), pa.array(list(cameras))))
    photo, _ = sorted(Counter(found.column("photo_id").to_pylist()).items(), key=lambda pair: pair[1])[-1]
    mine = found.filter(pc.equal(found.column("photo_id"), photo))
    surface, posed = Surface(model), {photo: enlarged(cameras[photo])}
    boxes = enlarged_boxes(mine, cameras[photo])
    rows = boxes.to_pylist()
    photographs = len(set(found.column("photo_id").to_pylist()))

    rays = cost_of(lambda: cast_detections(rows, posed, surface, settings), 21)
    alone = cost_of(lambda: observe_detections(boxes, posed, model, surface, settings, covariances), 11)
    campaign_wide = cost_of(lambda: observe_detections(found, cameras, model, surface, settings, covariances), 3)
    traced = cost_of(lambda: surface.render_depth(posed[photo], 1.0), 1)
    ready, whole = rendering(model, posed[photo])
    each = Cost(wall_s=campaign_wide.wall_s / photographs, cpu_s=campaign_wide.cpu_s / photographs)

    print(
        f"{datetime.now(UTC):%Y-%m-%d}, {platform.machine()}, {os.cpu_count()} cores, CPython "
        f"{platform.python_version()}, load {psutil.getloadavg()[0]:.1f}; {building_id} {campaign}, "
        f"{len(model.triangles)} triangles; {photo} with {len(rows)} detections "
        f"({len(cast_detections(rows, posed, surface, settings).rays.direction_site)} rays) at {HUGE[0]} x {HUGE[1]}\n"
    )
    print("| | wall s | processor s | to pyrender's pass | to all of pyrender | to ray casting |")
    print("|---|---|---|---|---|---|")
    for name, cost in (
        ("rays and patches of one photograph's detections", rays),
        ("the same with all columns, its campaign alone", alone),
        (f"the same, as a share of {photographs} photographs with {len(found)} detections", each),
        ("depth by pyrender, its pass in a process that stands ready", ready),
        ("depth by pyrender, with process and scene", whole),
        ("depth by casting every ray, distortion kept", traced),
    ):
        shares = " | ".join(f"1/{other.cpu_s / cost.cpu_s:.0f}" if other.cpu_s > cost.cpu_s else "" for other in
                            (ready, whole, traced))  # fmt: skip
        print(f"| {name} | {cost.wall_s:.4f} | {cost.cpu_s:.4f} | {shares} |")


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("building", nargs="?", default="demo")
    parser.add_argument("campaign", nargs="?", default="2026-04")
    parser.add_argument("--lake", type=Path, default=ROOT / "lake")
    parser.add_argument("--portfolio", type=Path, default=ROOT / "data" / "portfolio.yaml")
    parser.add_argument("--render", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.render:
        render_ready(asked.render)
    else:
        measure(asked.building, asked.campaign, asked.lake, asked.portfolio)


if __name__ == "__main__":
    main()
