"""Time and memory of the reconstruction of large campaigns: mapping of synthetic blocks, features and matching of real
photographs, and the comparison with pycolmap's defaults on the same photographs.

    .venv/bin/python -m benchmarks.scale mapping 100 300 1000
    .venv/bin/python -m benchmarks.scale mapping 100 300 --scene colmap
    .venv/bin/python -m benchmarks.scale features castle lund_street
    .venv/bin/python -m benchmarks.scale memory
    .venv/bin/python -m benchmarks.scale defaults 103

Prints Markdown. Each measurement runs in a process of its own, because peak memory is counted per process. CPU time is
stated besides wall time, because it depends little on the load of the machine.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.synthetic_block import generate_flight, write_block, write_colmap_block

ROOT = Path(__file__).resolve().parent.parent
SHARED = Path(os.environ.get("FACADELAKE_SHARED_DATA", ROOT.parent / "shared" / "data"))
PHOTOGRAPHS = {"castle": SHARED / "castle" / "images", "lund_street": SHARED / "drone" / "lund_street"}
BUILD = ROOT / "build" / "benchmarks"
LARGE_PX = (8000, 6000)


class CostMeter:
    """Meter of wall and CPU seconds (children included) since its creation, and of the peak memory of one process."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), self._read_cpu_s()

    @staticmethod
    def _read_cpu_s() -> float:
        used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(each.ru_utime + each.ru_stime for each in used)

    def read(self) -> dict[str, float]:
        """Seconds since creation, and peak memory of the process or of its largest child in MiB."""
        peaks = [resource.getrusage(who).ru_maxrss / 1024 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return {
            "wall_s": time.perf_counter() - self._wall,
            "cpu_s": self._read_cpu_s() - self._cpu,
            "peak_mb": max(peaks),
        }


def compute_camera_errors(centres: dict[str, Any], truth: dict[str, Any]) -> dict[str, float]:
    """Number, mean and largest error in metres of camera centres (3,) by photograph, after the best similarity."""
    from facadelake.core.frames import estimate_similarity

    names = sorted(centres.keys() & truth.keys())
    found, true = np.array([centres[name] for name in names]), np.array([truth[name] for name in names])
    error = np.linalg.norm(estimate_similarity(found, true).apply(found) - true, axis=1)
    return {"localised": len(names), "mean_m": float(error.mean()), "max_m": float(error.max())}


def measure_mapping(count: int, scene: str) -> dict[str, Any]:
    """Map and adjust a synthetic block of ``count`` photographs as the worker does; ``scene``: flight or colmap."""
    import io

    import pycolmap

    from facadelake.sfm import ReconstructionSettings
    from facadelake.sfm.pairing import choose_pairs
    from facadelake.sfm.worker.mapping import adjust_block, map_photographs
    from facadelake.sfm.worker.report import ProgressReport

    rng = np.random.default_rng(5)
    settings = ReconstructionSettings()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "features.db"
        if scene == "flight":
            flight = generate_flight(count, rng)
            noisy = flight.centres_m + rng.normal(0, 0.5, flight.centres_m.shape)
            pairs = choose_pairs(noisy, flight.directions, np.zeros(count, dtype=bool), settings)
            truth = write_block(path, flight, pairs, observations=1000, rng=rng)
        else:
            truth = write_colmap_block(path, count, partners=2 * settings.neighbours)
        with pycolmap.Database.open(path) as database:
            verified = database.num_verified_image_pairs()
        job = {
            "cameras": [{"width_px": 4000, "height_px": 3000}],
            "photos": [None] * count,
            "settings": {"seed": 1, "max_image_px": 4000},
            "cores": settings.cores,
            "photographs_root": folder,
        }
        pycolmap.logging.minloglevel = int(pycolmap.logging.Level.WARNING.value)
        pycolmap.set_random_seed(1)
        report = ProgressReport(stream=io.StringIO())
        cost = CostMeter()
        model = map_photographs(job, path, report)[0]
        adjust_block(model, job, report)
        spent = cost.read()
    centres = {image.name: image.projection_center() for image in model.images.values() if image.has_pose}
    return {
        "photographs": count,
        "pairs": verified,
        "steps": {cost.step: cost.cpu_seconds for cost in report.costs},
        **spent,
        **compute_camera_errors(centres, truth),
    }


def print_mapping(counts: list[int], scene: str) -> None:
    """Print time, memory and error of mapping, and the exponent of the growth of CPU time."""
    print(f"\n### Mapping, scene {scene}\n")
    print(
        "| photographs | verified pairs | wall s | CPU s | CPU s per photograph | peak MB | localised "
        "| camera error cm |\n|---|---|---|---|---|---|---|---|"
    )
    done = []
    for count in counts:
        figures = run_in_process("measure_mapping", count, scene)
        done.append(figures)
        print(
            f"| {count} | {figures['pairs']} | {figures['wall_s']:.0f} | {figures['cpu_s']:.0f} | "
            f"{figures['cpu_s'] / count:.2f} | {figures['peak_mb']:.0f} | {figures['localised']} | mean "
            f"{figures['mean_m'] * 100:.2f} max {figures['max_m'] * 100:.2f} |",
            flush=True,
        )
    for first, second in pairwise(done):
        slope = np.log(second["cpu_s"] / first["cpu_s"]) / np.log(second["photographs"] / first["photographs"])
        print(f"\nFrom {first['photographs']} to {second['photographs']}: CPU time grows as n^{slope:.2f}.")


def ingest_folder(photographs: Path) -> Any:
    """Table ``photos`` of a folder of photographs."""
    from facadelake.photos import ingest_photographs

    return ingest_photographs(photographs, distance_to_model_m=None, close_range_below_m=8.0)


def measure_reconstruction(photographs: str) -> dict[str, Any]:
    """Reconstruct a folder of photographs, all steps of the stage."""
    from facadelake.sfm import ReconstructionSettings, read_reconstruction, reconstruct

    root = Path(photographs)
    table = ingest_folder(root)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "block"
        cost = CostMeter()
        reconstruct(table, root, out, ReconstructionSettings())
        spent = cost.read()
        block = read_reconstruction(out)
        pairs = len(json.loads((out / "diagnostics" / "job.json").read_text())["pairs"])
    return {
        **spent,
        "photographs": len(table),
        "pairs": pairs,
        "centres": {p.photo_id: p.sfm_from_cam.translation.tolist() for p in block.photos},
        "reprojection_px": block.mean_reprojection_error_px,
        "steps": [(c.step, c.seconds, c.cpu_seconds, c.peak_memory_mb) for c in block.costs],
    }


def print_features(names: list[str]) -> None:
    """Print time, memory and rate (photographs or pairs per CPU second) of the steps of the stage."""
    print("\n### Features and matches of real photographs\n")
    print("| set | step | wall s | CPU s | rate (CPU) | peak MB |\n|---|---|---|---|---|---|")
    for name in names:
        figures = run_in_process("measure_reconstruction", str(PHOTOGRAPHS[name]))
        for step, wall, cpu, peak in figures["steps"]:
            per = {"Extracting features": ("photographs", "photographs"), "Matching features": ("pairs", "pairs")}
            rate = f"{figures[per[step][0]] / cpu:.2f} {per[step][1]}/s" if step in per else ""
            print(f"| {name} | {step} | {wall:.1f} | {cpu:.1f} | {rate} | {peak:.0f} |", flush=True)


def measure_extraction(photographs: str, threads: int) -> dict[str, Any]:
    """Extract the features of a folder of photographs with ``threads`` threads."""
    import io

    from facadelake.sfm import ReconstructionSettings
    from facadelake.sfm.worker import features as worker
    from facadelake.sfm.worker.report import ProgressReport

    names = sorted(path.name for path in Path(photographs).iterdir())
    camera = {"width_px": LARGE_PX[0], "height_px": LARGE_PX[1], "focal_px": 7000.0, "focal_known": True}
    photo = {"camera": 0, "prior_m": None, "prior_sigma_m": None}
    job = {
        "cameras": [camera],
        "photos": [{"photo_id": name, **photo} for name in names],
        "settings": ReconstructionSettings().cache_key,
        "cores": threads,
        "photographs_root": photographs,
    }
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "features.db"
        ids = worker.open_database(job, path)
        cost = CostMeter()
        worker.extract_features(job, path, ids, ProgressReport(stream=io.StringIO()))
        spent = cost.read()
    allowed = worker.estimate_memory_per_thread(job) / 2**20
    return {**spent, "photographs": len(names), "before_mb": before, "estimated_mb": before + threads * allowed}


def print_memory() -> None:
    """Print the peak memory of extracting features of 48 Mpx photographs, and the estimate that limits the threads."""
    import cv2

    print("\n### Features of 48 Mpx photographs\n")
    print("| threads | peak MB | estimated MB | CPU s per photograph |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for number, path in enumerate(sorted((PHOTOGRAPHS["castle"] / "multiview").iterdir())[:6]):
            large = cv2.resize(cv2.imread(str(path)), LARGE_PX, interpolation=cv2.INTER_CUBIC)
            cv2.imwrite(str(Path(folder) / f"{number}.jpg"), large)
        for threads in (1, 2, 4):
            figures = run_in_process("measure_extraction", folder, threads)
            each = figures["cpu_s"] / figures["photographs"]
            print(f"| {threads} | {figures['peak_mb']:.0f} | {figures['estimated_mb']:.0f} | {each:.1f} |", flush=True)


def generate_dense_demo(count: int) -> Path:
    """Generate a campaign of the demo building with ``count`` photographs; its folder."""
    from facadelake.demo import generate_demo, load_recipe

    recipe = load_recipe(ROOT / "data" / "demo" / "recipe.yaml")
    first = recipe.campaigns[0]
    close = sum(row.count for row in first.flight.close)
    flight = first.flight.model_copy(update={"orbit_count": count - close})
    dense = recipe.model_copy(update={"campaigns": [first.model_copy(update={"flight": flight})]})
    return generate_demo(dense, BUILD / f"demo-{count}").campaigns[0].folder


def measure_defaults(photographs: str) -> dict[str, Any]:
    """Reconstruct a folder of photographs by pycolmap alone, with its default options."""
    import pycolmap

    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.WARNING.value)
    pycolmap.set_random_seed(1)
    steps = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "features.db"
        whole = CostMeter()
        models: dict[int, Any] = {}
        for name, work in (
            ("Extracting features", lambda: pycolmap.extract_features(path, photographs)),
            ("Matching features", lambda: pycolmap.match_exhaustive(path)),
            ("Mapping photographs", lambda: models.update(pycolmap.incremental_mapping(path, photographs, folder))),
        ):
            cost = CostMeter()
            work()
            spent = cost.read()
            steps.append((name, spent["wall_s"], spent["cpu_s"], spent["peak_mb"]))
        total = whole.read()
    best = max(models.values(), key=lambda model: model.num_reg_images())
    return {
        **total,
        "steps": steps,
        "centres": {i.name: i.projection_center().tolist() for i in best.images.values() if i.has_pose},
        "reprojection_px": best.compute_mean_reprojection_error(),
    }


def print_defaults(count: int) -> None:
    """Print time and error of pycolmap's defaults and of the product on ``count`` photographs."""
    import csv

    folder = generate_dense_demo(count)
    with (folder / "truth" / "cameras.csv").open(encoding="utf-8") as lines:
        truth = {row["image"]: [float(row[f"{axis}_site_m"]) for axis in "xyz"] for row in csv.DictReader(lines)}
    print(f"\n### {len(truth)} photographs of the demo building: pycolmap's defaults and ours\n")
    print("| method | step | wall s | CPU s | peak MB |\n|---|---|---|---|---|")
    rows = {}
    for method, measure in (("ours", "measure_reconstruction"), ("defaults", "measure_defaults")):
        figures = rows[method] = run_in_process(measure, str(folder / "images"))
        for step, wall, cpu, peak in figures["steps"]:
            print(f"| {method} | {step} | {wall:.1f} | {cpu:.1f} | {peak:.0f} |")
        print(
            f"| {method} | all | {figures['wall_s']:.1f} | {figures['cpu_s']:.1f} | {figures['peak_mb']:.0f} |",
            flush=True,
        )
    print(
        "\n| method | localised | camera error mean / max cm (after a similarity) | reprojection px |\n"
        "|---|---|---|---|"
    )
    errors = {method: compute_camera_errors(figures["centres"], truth) for method, figures in rows.items()}
    for method, error in errors.items():
        print(f"| {method} | {error['localised']} | {error['mean_m'] * 100:.2f} / {error['max_m'] * 100:.2f} | "
              f"{rows[method]['reprojection_px']:.3f} |")  # fmt: skip
    wall, cpu = (rows["ours"][key] / rows["defaults"][key] for key in ("wall_s", "cpu_s"))
    print(f"\nRatio ours / defaults: wall {wall:.2f}, CPU {cpu:.2f}, "
          f"error {errors['ours']['mean_m'] / errors['defaults']['mean_m']:.2f}.")  # fmt: skip


def run_in_process(function: str, *arguments: Any) -> dict[str, Any]:
    """Call a function of this module in a process of its own; its result."""
    code = f"import json, sys; from benchmarks import scale; print(json.dumps(scale.{function}(*{arguments!r})))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{function}{arguments} failed:\n{done.stderr}")
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    subcommands = parser.add_subparsers(required=True, dest="command")
    mapping_parser = subcommands.add_parser("mapping")
    mapping_parser.add_argument("counts", nargs="+", type=int)
    mapping_parser.add_argument("--scene", choices=["flight", "colmap"], default="flight")
    subcommands.add_parser("features").add_argument("names", nargs="+", choices=sorted(PHOTOGRAPHS))
    subcommands.add_parser("memory")
    subcommands.add_parser("defaults").add_argument("count", type=int)
    options = parser.parse_args()
    gib = psutil.virtual_memory().total / 2**30
    load = os.getloadavg()[0]
    print(f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, {psutil.cpu_count()} cores, {gib:.0f} GiB, load {load:.1f} before, "
          f"Python {platform.python_version()}")  # fmt: skip
    match options.command:
        case "mapping":
            print_mapping(options.counts, options.scene)
        case "features":
            print_features(options.names)
        case "memory":
            print_memory()
        case "defaults":
            print_defaults(options.count)
    print(f"\nload {os.getloadavg()[0]:.1f} after")


if __name__ == "__main__":
    main()
