"""Detection in large photographs: throughput against onnxruntime alone, and long cracks across tiles.

    .venv/bin/python -m benchmarks.detector throughput [--model FILE] [--photograph FILE] [--threads 2]
    .venv/bin/python -m benchmarks.detector seams [--scenes 40]

``throughput``: tiles per second of a photograph of 48 Mpx in memory (tiling, preprocessing, inference, reading of
outputs and merging) against onnxruntime alone on the same tiles, preprocessed beforehand: once with all threads per
tile, once with one thread per tile and as many tiles at once. ``seams``: simulated cracks
(``benchmarks.detector_seams``).
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime

from benchmarks.detector_seams import compare_merging_methods
from facadelake.core.arrays import Float32Array, UInt8Image
from facadelake.detection import find_default_model
from facadelake.detection.inference import load_detector
from facadelake.detection.inference.letterbox import fit_letterbox
from facadelake.detection.tiling import detect_image
from facadelake.detection.tiling.plan import plan_tile_passes


@dataclass(frozen=True, kw_only=True)
class Speed:
    """Tiles per second of wall time, and milliseconds of CPU time per tile."""

    tiles_per_s: float
    cpu_ms: float


def measure_throughput(model: Path, image: UInt8Image, threads: int, rounds: int) -> None:
    """Print the speed of ``detect_image`` and of onnxruntime alone, in alternation; the best of ``rounds`` each."""
    height, width = image.shape[:2]
    detector = load_detector(model, threads=1)
    spec = detector.card.input
    tiles = [tile for tile_pass in plan_tile_passes(spec, width_px=width, height_px=height) for tile in tile_pass.tiles]
    ready = []
    for tile in tiles:
        crop = image[tile.top : tile.bottom, tile.left : tile.right]
        box = fit_letterbox(spec, image_width_px=crop.shape[1], image_height_px=crop.shape[0])
        ready.append(box.input_from_image(crop))
    encoded = cv2.imencode(".jpg", image)[1]
    ours, together, apart, decoding = [], [], [], []
    for _ in range(rounds):
        ours.append(_measure_speed(len(tiles), partial(detect_image, detector, image, workers=threads)))
        together.append(_measure_session(model, ready, threads=threads, callers=1))
        apart.append(_measure_session(model, ready, threads=1, callers=threads))
        decoding.append(_measure_speed(1, partial(cv2.imdecode, encoded, cv2.IMREAD_COLOR)))
    mega = width * height / 1e6
    print(f"{model.name}, {spec.width_px} x {spec.height_px}, {len(tiles)} tiles of {mega:.0f} Mpx, {threads} threads")
    bare = {f"session of {threads} threads": together, f"session, {threads} callers of 1 thread": apart}
    for name, speeds in {"detect_image, from pixels to boxes": ours, **bare}.items():
        best, least = max(one.tiles_per_s for one in speeds), min(one.cpu_ms for one in speeds)
        print(f"{name:38s} {best:7.1f} tiles/s {least:7.2f} CPU ms per tile")
    limit = max(one.tiles_per_s for one in [*together, *apart])
    fastest = max(one.tiles_per_s for one in ours)
    least = min(one.cpu_ms for one in [*together, *apart]) / min(one.cpu_ms for one in ours)
    print(f"ratio to the faster session alone: {fastest / limit:.2f} by wall time, {least:.2f} by CPU time")
    print(
        f"photographs of {mega:.0f} Mpx per minute, without decoding: {60 * fastest / len(tiles):.2f}; decoding one "
        f"takes {min(one.cpu_ms for one in decoding) / 1000:.2f} CPU s"
    )


def _read_photograph(path: Path | None, width: int, height: int) -> UInt8Image:
    """A photograph (height, width, 3) resized to the given size; noise where no path is given."""
    if path is None:
        return np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    image = cv2.imread(str(path))
    if image is None:
        raise SystemExit(f"{path} cannot be decoded")
    return np.asarray(cv2.resize(image, (width, height)), dtype=np.uint8)


def _measure_speed(tiles: int, work: Callable[[], Any]) -> Speed:
    start, busy = time.perf_counter(), time.process_time()
    work()
    seconds, busy = time.perf_counter() - start, time.process_time() - busy
    return Speed(tiles_per_s=tiles / seconds, cpu_ms=1000 * busy / tiles)


def _measure_session(model: Path, ready: Sequence[Float32Array], *, threads: int, callers: int) -> Speed:
    """Speed of onnxruntime alone on preprocessed inputs."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    session.run(None, {name: ready[0]})

    def run_session() -> None:
        with ThreadPoolExecutor(callers) as pool:
            for _ in pool.map(lambda values: session.run(None, {name: values}), ready):
                pass

    return _measure_speed(len(ready), run_session)


def compare_mergers(scenes: int) -> None:
    """Print the outcome of the cracks by pattern and merging method."""
    print("cracks          merging        as one  duplicated  cut  joined  missed  extra boxes")
    for pattern, method, cracks, counts in compare_merging_methods(scenes):
        share = counts["as one"] / cracks
        print(
            f"{pattern:15s} {method:13s} {share:7.1%} {counts['duplicated']:11d} {counts['cut']:4d} "
            f"{counts['joined']:7d} {counts['missed']:7d} {counts['extra boxes']:12d} of {cracks} cracks",
            flush=True,
        )


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    speed = commands.add_parser("throughput")
    speed.add_argument("--model", type=Path, help="ONNX file with its card; the default model if omitted")
    speed.add_argument("--photograph", type=Path, help="photograph; noise if omitted")
    speed.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    speed.add_argument("--rounds", type=int, default=3, help="repetitions, of which the best counts")
    speed.add_argument("--size", type=int, nargs=2, default=(8000, 6000), metavar=("WIDTH", "HEIGHT"))
    commands.add_parser("seams").add_argument("--scenes", type=int, default=40)
    options = parser.parse_args()
    if options.command == "seams":
        compare_mergers(options.scenes)
    else:
        image = _read_photograph(options.photograph, *options.size)
        measure_throughput(options.model or find_default_model(), image, options.threads, options.rounds)


if __name__ == "__main__":
    main()
