"""Measure what a thousand photographs cost: mapping on synthetic blocks, features and matches on real photographs, and
the same hundred photographs through pycolmap's defaults and through ours.

    .venv/bin/python -m benchmarks.scale mapping 100 300 1000
    .venv/bin/python -m benchmarks.scale mapping 100 300 --scene colmap
    .venv/bin/python -m benchmarks.scale features castle lund_street
    .venv/bin/python -m benchmarks.scale memory
    .venv/bin/python -m benchmarks.scale defaults 103

Prints Markdown. Each measurement runs in a process of its own, so that its peak memory is its own; processor time is
given beside wall time, for machines that do other work too.
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

from benchmarks.synthetic_block import fly, write_block, write_colmap_block

ROOT = Path(__file__).resolve().parent.parent
SHARED = Path(os.environ.get("FACADELAKE_SHARED_DATA", ROOT.parent / "shared" / "data"))
PHOTOGRAPHS = {"castle": SHARED / "castle" / "images", "lund_street": SHARED / "drone" / "lund_street"}
BUILD = ROOT / "build" / "benchmarks"
HUGE = (8000, 6000)


class Cost:
    """Wall and processor seconds (children included) since it was made, and the peak memory of any one process."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), self._processor()

    @staticmethod
    def _processor() -> float:
        used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(each.ru_utime + each.ru_stime for each in used)

    def read(self) -> dict[str, float]:
        peaks = [resource.getrusage(who).ru_maxrss / 1024 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return {
            "wall_s": time.perf_counter() - self._wall,
            "cpu_s": self._processor() - self._cpu,
            "peak_mb": max(peaks),
        }


def camera_errors_m(centres: dict[str, Any], truth: dict[str, Any]) -> dict[str, float]:
    """Distances of the centres to the true ones after the similarity that fits them best."""
    from facadelake.core.frames import estimate_similarity

    names = sorted(centres.keys() & truth.keys())
    found, true = np.array([centres[name] for name in names]), np.array([truth[name] for name in names])
    error = np.linalg.norm(estimate_similarity(found, true).apply(found) - true, axis=1)
    return {"localised": len(names), "mean_m": float(error.mean()), "max_m": float(error.max())}


def measure_mapping(count: int, scene: str) -> dict[str, Any]:
    """Mapping and adjustment, as the worker does them, of a synthetic block."""
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
            flight = fly(count, rng)
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
        cost = Cost()
        model = map_photographs(job, path, report)[0]
        adjust_block(model, job, report)
        spent = cost.read()
    centres = {image.name: image.projection_center() for image in model.images.values() if image.has_pose}
    return {
        "photographs": count,
        "pairs": verified,
        "steps": {cost.step: cost.cpu_seconds for cost in report.costs},
        **spent,
        **camera_errors_m(centres, truth),
    }


def mapping(counts: list[int], scene: str) -> None:
    """Time, memory and error of mapping, and how time grows."""
    print(f"\n### Mapping, scene {scene}\n")
    print(
        "| photographs | verified pairs | wall s | CPU s | CPU s a photograph | peak MB | localised | camera error cm |"
    )
    print("|---|---|---|---|---|---|---|---|")
    done = []
    for count in counts:
        figures = apart("measure_mapping", count, scene)
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


def table_of(photographs: Path) -> Any:
    """Table `photos` of a folder, as ``ingest`` makes it."""
    from facadelake.photos import ingest_photographs

    return ingest_photographs(photographs, distance_to_model_m=None, close_range_below_m=8.0)


def measure_reconstruction(photographs: str) -> dict[str, Any]:
    """The whole stage on a folder of photographs."""
    from facadelake.sfm import ReconstructionSettings, read_reconstruction, reconstruct

    root = Path(photographs)
    table = table_of(root)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "block"
        cost = Cost()
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


def features(names: list[str]) -> None:
    """Photographs and pairs a second of the stage's steps."""
    print("\n### Features and matches of real photographs\n")
    print("| set | step | wall s | CPU s | rate (CPU) | peak MB |\n|---|---|---|---|---|---|")
    for name in names:
        figures = apart("measure_reconstruction", str(PHOTOGRAPHS[name]))
        for step, wall, cpu, peak in figures["steps"]:
            per = {"Extracting features": ("photographs", "photographs"), "Matching features": ("pairs", "pairs")}
            rate = f"{figures[per[step][0]] / cpu:.2f} {per[step][1]}/s" if step in per else ""
            print(f"| {name} | {step} | {wall:.1f} | {cpu:.1f} | {rate} | {peak:.0f} |", flush=True)


def measure_extraction(photographs: str, threads: int) -> dict[str, Any]:
    """Features alone, with so many threads."""
    import io

    from facadelake.sfm import ReconstructionSettings
    from facadelake.sfm.worker import features as worker
    from facadelake.sfm.worker.report import ProgressReport

    names = sorted(path.name for path in Path(photographs).iterdir())
    camera = {"width_px": HUGE[0], "height_px": HUGE[1], "focal_px": 7000.0, "focal_known": True}
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
        cost = Cost()
        worker.extract_features(job, path, ids, ProgressReport(stream=io.StringIO()))
        spent = cost.read()
    allowed = worker.estimate_memory_per_thread(job) / 2**20
    return {**spent, "photographs": len(names), "before_mb": before, "estimated_mb": before + threads * allowed}


def memory() -> None:
    """Peak memory of finding features in 48 Mpx photographs against the estimate that bounds the threads."""
    import cv2

    print("\n### Features of 48 Mpx photographs\n")
    print("| threads | peak MB | estimated MB | CPU s a photograph |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for number, path in enumerate(sorted((PHOTOGRAPHS["castle"] / "multiview").iterdir())[:6]):
            large = cv2.resize(cv2.imread(str(path)), HUGE, interpolation=cv2.INTER_CUBIC)
            cv2.imwrite(str(Path(folder) / f"{number}.jpg"), large)
        for threads in (1, 2, 4):
            figures = apart("measure_extraction", folder, threads)
            each = figures["cpu_s"] / figures["photographs"]
            print(f"| {threads} | {figures['peak_mb']:.0f} | {figures['estimated_mb']:.0f} | {each:.1f} |", flush=True)


def dense_demo(count: int) -> Path:
    """The demo building, photographed more densely: one campaign of ``count`` photographs; its folder."""
    from facadelake.demo import generate_demo, load_recipe

    recipe = load_recipe(ROOT / "data" / "demo" / "recipe.yaml")
    first = recipe.campaigns[0]
    close = sum(row.count for row in first.flight.close)
    flight = first.flight.model_copy(update={"orbit_count": count - close})
    dense = recipe.model_copy(update={"campaigns": [first.model_copy(update={"flight": flight})]})
    return generate_demo(dense, BUILD / f"demo-{count}").campaigns[0].folder


def measure_defaults(photographs: str) -> dict[str, Any]:
    """The same photographs through pycolmap alone, every option as it comes."""
    import pycolmap

    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.WARNING.value)
    pycolmap.set_random_seed(1)
    steps = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "features.db"
        whole = Cost()
        models: dict[int, Any] = {}
        for name, work in (
            ("Extracting features", lambda: pycolmap.extract_features(path, photographs)),
            ("Matching features", lambda: pycolmap.match_exhaustive(path)),
            ("Mapping photographs", lambda: models.update(pycolmap.incremental_mapping(path, photographs, folder))),
        ):
            cost = Cost()
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


def defaults(count: int) -> None:
    """Time and error of pycolmap's defaults and of ours, in one run."""
    import csv

    folder = dense_demo(count)
    with (folder / "truth" / "cameras.csv").open(encoding="utf-8") as lines:
        truth = {row["image"]: [float(row[f"{axis}_site_m"]) for axis in "xyz"] for row in csv.DictReader(lines)}
    print(f"\n### {len(truth)} photographs of the demo building: pycolmap's defaults and ours\n")
    print("| way | step | wall s | CPU s | peak MB |\n|---|---|---|---|---|")
    rows = {}
    for way, measure in (("ours", "measure_reconstruction"), ("defaults", "measure_defaults")):
        figures = rows[way] = apart(measure, str(folder / "images"))
        for step, wall, cpu, peak in figures["steps"]:
            print(f"| {way} | {step} | {wall:.1f} | {cpu:.1f} | {peak:.0f} |")
        print(
            f"| {way} | all | {figures['wall_s']:.1f} | {figures['cpu_s']:.1f} | {figures['peak_mb']:.0f} |", flush=True
        )
    print(
        "\n| way | localised | camera error mean / max cm (after a similarity) | reprojection px |\n|---|---|---|---|"
    )
    errors = {way: camera_errors_m(figures["centres"], truth) for way, figures in rows.items()}
    for way, error in errors.items():
        print(f"| {way} | {error['localised']} | {error['mean_m'] * 100:.2f} / {error['max_m'] * 100:.2f} | "
              f"{rows[way]['reprojection_px']:.3f} |")  # fmt: skip
    wall, cpu = (rows["ours"][key] / rows["defaults"][key] for key in ("wall_s", "cpu_s"))
    print(f"\nRatio ours / defaults: wall {wall:.2f}, CPU {cpu:.2f}, "
          f"error {errors['ours']['mean_m'] / errors['defaults']['mean_m']:.2f}.")  # fmt: skip


def apart(function: str, *arguments: Any) -> dict[str, Any]:
    """A function of this module in a process of its own."""
    code = f"import json, sys; from benchmarks import scale; print(json.dumps(scale.{function}(*{arguments!r})))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{function}{arguments} failed:\n{done.stderr}")
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


def main() -> None:
    """Run what is named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    what = parser.add_subparsers(required=True, dest="what")
    of_mapping = what.add_parser("mapping")
    of_mapping.add_argument("counts", nargs="+", type=int)
    of_mapping.add_argument("--scene", choices=["flight", "colmap"], default="flight")
    what.add_parser("features").add_argument("names", nargs="+", choices=sorted(PHOTOGRAPHS))
    what.add_parser("memory")
    what.add_parser("defaults").add_argument("count", type=int)
    chosen = parser.parse_args()
    gib = psutil.virtual_memory().total / 2**30
    load = os.getloadavg()[0]
    print(f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, {psutil.cpu_count()} cores, {gib:.0f} GiB, load {load:.1f} before, "
          f"Python {platform.python_version()}")  # fmt: skip
    match chosen.what:
        case "mapping":
            mapping(chosen.counts, chosen.scene)
        case "features":
            features(chosen.names)
        case "memory":
            memory()
        case "defaults":
            defaults(chosen.count)
    print(f"\nload {os.getloadavg()[0]:.1f} after")


if __name__ == "__main__":
    main()
