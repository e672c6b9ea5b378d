"""Run time of registering the detections of a photograph, against rendering its depth image at 48 Mpx.

    .venv/bin/python -m benchmarks.virtual_camera castle 2026-04 --lake lake

Both are measured in one run, with the portfolio's model and the committed poses and detections of a campaign. The
photograph's camera is scaled to 8000 x 6000 pixels. Prints Markdown: wall time and CPU time (all threads and children),
which depends little on the load of the machine; for short runs the median of several.
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
LARGE_PX = (8000, 6000)


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Wall and CPU seconds of a run."""

    wall_s: float
    cpu_s: float


def _read_cpu_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def measure_timing(run: Callable[[], object], times: int) -> Timing:
    """Median over ``times`` runs; if there are several, a first one is not counted."""
    if times > 1:
        run()
    walls, cpus = [], []
    for _ in range(times):
        wall, cpu = time.perf_counter(), _read_cpu_s()
        run()
        walls.append(time.perf_counter() - wall)
        cpus.append(_read_cpu_s() - cpu)
    return Timing(wall_s=float(np.median(walls)), cpu_s=float(np.median(cpus)))


def enlarge_camera(posed: PosedCamera) -> PosedCamera:
    """The same camera with 8000 x 6000 pixels."""
    camera = posed.camera
    across, down = LARGE_PX[0] / camera.width_px, LARGE_PX[1] / camera.height_px
    return PosedCamera(
        camera=Camera(
            width_px=LARGE_PX[0], height_px=LARGE_PX[1],
            fx_px=camera.fx_px * across, fy_px=camera.fy_px * down,
            cx_px=camera.cx_px * across, cy_px=camera.cy_px * down,
            k1=camera.k1, k2=camera.k2, p1=camera.p1, p2=camera.p2,
        ),
        site_from_cam=posed.site_from_cam,
    )  # fmt: skip


def enlarge_boxes(detections: pa.Table, posed: PosedCamera) -> pa.Table:
    """Boxes scaled to the enlarged photograph; masks are omitted."""
    across, down = LARGE_PX[0] / posed.camera.width_px, LARGE_PX[1] / posed.camera.height_px
    for name, factor in (("x", across), ("y", down), ("width", across), ("height", down)):
        column = f"box_{name}_px"
        at = detections.column_names.index(column)
        detections = detections.set_column(
            at, detections.schema.field(column), pc.multiply(detections.column(column), factor)
        )
    at = detections.column_names.index("mask")
    return detections.set_column(at, detections.schema.field("mask"), pa.nulls(len(detections), pa.string()))


def measure_rendering(model: BuildingModel, posed: PosedCamera) -> tuple[Timing, Timing]:
    """Time one depth image by pyrender: the rendering pass alone, and including process and scene."""
    straight = replace(posed, camera=replace(posed.camera, k1=0.0, k2=0.0, p1=0.0, p2=0.0))
    with tempfile.TemporaryDirectory(prefix="facadelake-benchmark-") as folder:
        lines: list[str] = []

        def run() -> None:
            write_scene(Path(folder), model, straight, *LARGE_PX)
            done = subprocess.run(
                [sys.executable, "-m", "benchmarks.virtual_camera", "--render", folder],
                capture_output=True, text=True, check=True, cwd=ROOT, env={**os.environ, "PYOPENGL_PLATFORM": "egl"},
            )  # fmt: skip
            lines.append(done.stdout.splitlines()[-1])

        with_process = measure_timing(run, 1)
    wall, cpu = (float(value) for value in lines[-1].split())
    return Timing(wall_s=wall, cpu_s=cpu), with_process


def print_render_timing(folder: Path) -> None:
    """Print wall and CPU seconds of the second depth image (in the process of the renderer)."""
    from facadelake.building.surface.render_worker import RenderView

    view = RenderView(folder)
    timing = measure_timing(view.render_depth_buffer, 2)
    print(timing.wall_s, timing.cpu_s)


def print_comparison(building_id: str, campaign: str, lake: Path, portfolio: Path) -> None:
    """Print the table for the photograph with the most detections of a campaign."""
    building = read_portfolio(portfolio).get_building(building_id)
    model, settings = read_registered_model(building), resolve_registration_settings(building)
    tables = read_tables(lake, ["poses", "detections"], building_id=building_id, campaign_id=campaign)
    cameras, covariances = read_posed_cameras(tables["poses"]), read_pose_covariances(tables["poses"])
    accepted = tables["detections"].filter(pc.equal(tables["detections"].column("detection_outcome"), "accepted"))
    accepted = accepted.filter(pc.is_in(accepted.column("photo_id"), pa.array(list(cameras))))
    photo, _ = sorted(Counter(accepted.column("photo_id").to_pylist()).items(), key=lambda pair: pair[1])[-1]
    own = accepted.filter(pc.equal(accepted.column("photo_id"), photo))
    surface, posed = Surface(model), {photo: enlarge_camera(cameras[photo])}
    boxes = enlarge_boxes(own, cameras[photo])
    rows = boxes.to_pylist()
    photographs = len(set(accepted.column("photo_id").to_pylist()))

    rays = measure_timing(lambda: cast_detections(rows, posed, surface, settings), 21)
    alone = measure_timing(lambda: observe_detections(boxes, posed, model, surface, settings, covariances), 11)
    campaign_wide = measure_timing(
        lambda: observe_detections(accepted, cameras, model, surface, settings, covariances), 3
    )
    traced = measure_timing(lambda: surface.render_depth(posed[photo], 1.0), 1)
    pass_only, with_process = measure_rendering(model, posed[photo])
    each = Timing(wall_s=campaign_wide.wall_s / photographs, cpu_s=campaign_wide.cpu_s / photographs)

    print(
        f"{datetime.now(UTC):%Y-%m-%d}, {platform.machine()}, {os.cpu_count()} cores, CPython "
        f"{platform.python_version()}, load {psutil.getloadavg()[0]:.1f}; {building_id} {campaign}, "
        f"{len(model.triangles)} triangles; {photo} with {len(rows)} detections "
        f"({len(cast_detections(rows, posed, surface, settings).rays.direction_site)} rays) at "
        f"{LARGE_PX[0]} x {LARGE_PX[1]}\n"
    )
    print("| | wall s | CPU s | of pyrender's pass | of all of pyrender | of ray casting |")
    print("|---|---|---|---|---|---|")
    for name, timing in (
        ("rays and patches of one photograph's detections", rays),
        ("the same with all columns, as a campaign of one photograph", alone),
        (f"the same, per photograph of a campaign of {photographs} with {len(accepted)} detections", each),
        ("depth by pyrender, rendering pass only", pass_only),
        ("depth by pyrender, with process and scene", with_process),
        ("depth by casting every ray, with distortion", traced),
    ):
        shares = " | ".join(f"1/{other.cpu_s / timing.cpu_s:.0f}" if other.cpu_s > timing.cpu_s else "" for other in
                            (pass_only, with_process, traced))  # fmt: skip
        print(f"| {name} | {timing.wall_s:.4f} | {timing.cpu_s:.4f} | {shares} |")


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("building", nargs="?", default="demo")
    parser.add_argument("campaign", nargs="?", default="2026-04")
    parser.add_argument("--lake", type=Path, default=ROOT / "lake")
    parser.add_argument("--portfolio", type=Path, default=ROOT / "data" / "portfolio.yaml")
    parser.add_argument("--render", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.render:
        print_render_timing(options.render)
    else:
        print_comparison(options.building, options.campaign, options.lake, options.portfolio)


if __name__ == "__main__":
    main()
