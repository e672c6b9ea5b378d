"""The detector on large photographs: tiles a second beside the bare session, and what uniting does to long cracks.

    .venv/bin/python -m benchmarks.detector throughput [--model FILE] [--photograph FILE] [--threads 2]
    .venv/bin/python -m benchmarks.detector seams [--scenes 40]

``throughput``: a photograph of 48 Mpx in memory, cut, prepared, run, read and united, against onnxruntime alone on the
same tiles made ready before; once a session of all threads, once as many callers of one thread each. ``seams``: made
cracks (``benchmarks.detector_seams``).
"""

from __future__ import annotations

import argparse
import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import onnxruntime

from benchmarks.detector_seams import compare
from facadelake.detect.detector import load_detector
from facadelake.detect.letterbox import Image, letterbox
from facadelake.detect.shelf import default_model
from facadelake.detect.tiling import detect_image
from facadelake.detect.tiling.plan import plan_looks

WIDTH, HEIGHT = 8000, 6000


def throughput(model: Path, photograph: Path | None, threads: int, rounds: int) -> None:
    """Print tiles a second of ours and of the bare session, the best of ``rounds`` each, taken in turn."""
    image = _photograph(photograph)
    detector = load_detector(model, threads=1)
    spec = detector.card.input
    looks = plan_looks(spec, width_px=WIDTH, height_px=HEIGHT)
    tiles = [tile for look in looks for tile in look.tiles]
    ready = []
    for tile in tiles:
        crop = image[tile.top : tile.bottom, tile.left : tile.right]
        box = letterbox(spec, image_width_px=crop.shape[1], image_height_px=crop.shape[0])
        ready.append(box.input_from_image(crop))
    ours, shared, apart = [], [], []
    for _ in range(rounds):
        start = time.perf_counter()
        found = detect_image(detector, image, workers=threads)
        ours.append(len(tiles) / (time.perf_counter() - start))
        shared.append(_bare(model, ready, threads=threads, callers=1))
        apart.append(_bare(model, ready, threads=1, callers=threads))
    start = time.perf_counter()
    encoded = cv2.imencode(".jpg", image)[1]
    start = time.perf_counter()
    cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    decode_s = time.perf_counter() - start
    limit = max(*shared, *apart)
    print(f"{model.name}, {spec.width_px} x {spec.height_px}, {len(tiles)} tiles of 48 Mpx, {threads} threads")
    print(f"ours, from pixels to united boxes    {max(ours):7.1f} tiles/s ({len(found)} found)")
    print(f"bare session of {threads} threads            {max(shared):7.1f} tiles/s")
    print(f"bare session, {threads} callers of 1 thread  {max(apart):7.1f} tiles/s")
    print(f"ratio to the better bare one         {max(ours) / limit:7.2f}")
    print(f"photographs of 48 Mpx a minute       {60 * max(ours) / len(tiles):7.2f} (decoding one: {decode_s:.2f} s)")


def _photograph(path: Path | None) -> Image:
    """A photograph enlarged to 48 Mpx; noise without one."""
    if path is None:
        return np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(cv2.imread(str(path)), (WIDTH, HEIGHT)), dtype=np.uint8)


def _bare(model: Path, ready: list[np.ndarray], *, threads: int, callers: int) -> float:
    """Tiles a second of onnxruntime alone on inputs that are ready."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    session.run(None, {name: ready[0]})
    start = time.perf_counter()
    with ThreadPoolExecutor(callers) as pool:
        list(pool.map(lambda values: session.run(None, {name: values}) and None, ready))
    return len(ready) / (time.perf_counter() - start)


def seams(scenes: int) -> None:
    """Print what became of the cracks, kind by kind and way by way."""
    print("cracks          uniting        as one  doubled  cut  glued  missed  boxes too many")
    for kind, way, cracks, said in compare(scenes):
        share = said["as one"] / cracks
        print(
            f"{kind:15s} {way:13s} {share:7.1%} {said['doubled']:8d} {said['cut']:4d} {said['glued']:6d} "
            f"{said['missed']:7d} {said['boxes too many']:9d} of {cracks} cracks",
            flush=True,
        )


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    speed = commands.add_parser("throughput")
    speed.add_argument("--model", type=Path, help="an ONNX file with its card; the default model if left out")
    speed.add_argument("--photograph", type=Path)
    speed.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    speed.add_argument("--rounds", type=int, default=3)
    commands.add_parser("seams").add_argument("--scenes", type=int, default=40)
    options = parser.parse_args()
    if options.command == "seams":
        seams(options.scenes)
    else:
        throughput(options.model or default_model(), options.photograph, options.threads, options.rounds)


if __name__ == "__main__":
    main()
