"""Measure our way through large photographs beside SAHI's: one model, the same photographs, tiles and threads, one run.

    uv venv build/sahi && uv pip install -p build/sahi sahi onnxruntime scipy scikit-image pydantic filelock
    PYTHONPATH=. build/sahi/bin/python -m benchmarks.sahi_comparison data/detector/facadelake-nano.onnx A.JPG B.JPG
    PYTHONPATH=. build/sahi/bin/python -m benchmarks.sahi_comparison data/detector/facadelake-nano.onnx A.JPG \
        --size 8000x6000

SAHI (MIT) is no dependency of ours: without it, this says so. Three ways, in turns, ``--repeats`` times, each
photograph decoded beforehand:

bare   the onnxruntime session alone, on as many inputs as our way looks at: the limit; once with all threads for each
       input, once with a thread for each and as many inputs at once
ours   ``detect_image``: tiles, inference and what the borders cut put together
sahi   ``get_sliced_prediction``: slices of the same size with the same overlap and a look at the whole, merged by its
       default (greedy NMM on IOS). Its adapter below reads the model by our own letterbox and layout, so that what
       differs is the way through the photograph, not the reading of the model. A model of layout yolov8 is measured a
       second time with SAHI's own adapter, where ``ultralytics`` (AGPL-3.0) stands in that environment too

Prints Markdown: seconds a photograph (the fastest and the median), processor seconds (which other work on the machine
changes little), tiles a second, boxes, and how
many of either's boxes the other has too (IoU 0.5). No truth here: which of two different answers is better is measured
by ``facadelake evaluate-detector`` and by benchmarks/detector.py's seams.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from facadelake.detection import ModelCard
from facadelake.detection.card import OutputLayout
from facadelake.detection.inference import DetectedBox, OnnxDetector, load_detector
from facadelake.detection.tiling import detect_image
from facadelake.detection.tiling.plan import OVERLAP_RATIO, plan_tile_passes

try:
    import sahi
    from sahi import AutoDetectionModel
    from sahi.models.base import DetectionModel
    from sahi.predict import get_sliced_prediction
    from sahi.prediction import ObjectPrediction
    from sahi.utils.compatibility import fix_full_shape_list, fix_shift_amount_list
except ImportError:
    sys.exit("sahi is not installed here; it is no dependency of facadelake: see the head of this file for a venv")

Image = NDArray[np.uint8]


class Slices(DetectionModel):  # type: ignore[misc]
    """SAHI's model class around a detector of ours: one slice at a time, as its own adapters do."""

    def set_model(self, model: Any, **kwargs: Any) -> None:
        self.model = model
        self.category_mapping = {str(i): name for i, name in enumerate(model.card.class_names)}
        self.ids = {name: i for i, name in enumerate(model.card.class_names)}

    def set_device(self, device: str | None = None) -> None:
        self.device = "cpu"

    def perform_inference(self, image: Image) -> None:
        self._original_predictions = self.model.detect(np.ascontiguousarray(image[:, :, ::-1]))  # SAHI gives RGB

    def _create_object_prediction_list_from_original_predictions(
        self, shift_amount_list: Any = None, full_shape_list: Any = None
    ) -> None:
        shift = fix_shift_amount_list(shift_amount_list)[0]
        shape = (fix_full_shape_list(full_shape_list) or [None])[0]
        self._object_prediction_list_per_image = [
            [
                ObjectPrediction(
                    bbox=_corners(one),
                    category_id=self.ids[one.class_name],
                    category_name=one.class_name,
                    score=one.score,
                    shift_amount=shift,
                    full_shape=shape,
                )
                for one in self._original_predictions
            ]
        ]


@dataclass(kw_only=True)
class Way:
    """What one way took, a repetition an entry."""

    run: Callable[[Image], Sequence[NDArray[np.float64]]]
    wall_s: list[float] = field(default_factory=list)
    cpu_s: list[float] = field(default_factory=list)
    boxes: Sequence[NDArray[np.float64]] = ()

    def measure(self, image: Image) -> None:
        wall, cpu = time.perf_counter(), _cpu_s()
        self.boxes = self.run(image)
        self.wall_s.append(time.perf_counter() - wall)
        self.cpu_s.append(_cpu_s() - cpu)


def compare(image: Image, model: Path, card: Path | None, *, threads: int, repeats: int) -> dict[str, Any]:
    """All three ways through one photograph, in turns."""
    one_each = load_detector(model, card, threads=1)
    all_in_one = load_detector(model, card, threads=threads)
    spec = one_each.card.input
    height, width = image.shape[:2]
    passes = plan_tile_passes(spec, width_px=width, height_px=height)
    tiles = sum(len(tile_pass.tiles) for tile_pass in passes)
    wrapped = Slices(model=all_in_one, confidence_threshold=one_each.card.score_threshold, image_size=spec.width_px)
    # One session of all threads, or a session of one thread fed by as many workers: each way has its faster one.
    ways = {
        "bare": Way(run=lambda _: _bare(model, one_each.card, threads=threads, tiles=tiles, workers=1)),
        "bare, a thread each": Way(run=lambda _: _bare(model, one_each.card, threads=1, tiles=tiles, workers=threads)),
        "ours": Way(run=lambda photo: _ours(one_each, photo, threads)),
        "sahi": Way(run=lambda photo: _sahi(wrapped, photo, spec.width_px, spec.height_px)),
    }
    for count in {1, threads}:
        _session_of(model, count)
    if one_each.card.output.layout is OutputLayout.YOLOV8 and find_spec("ultralytics"):
        stock = AutoDetectionModel.from_pretrained(
            "ultralytics",
            model_path=str(model),
            confidence_threshold=one_each.card.score_threshold,
            image_size=spec.width_px,
            device="cpu",
        )
        ways["sahi, its own adapter"] = Way(run=lambda photo: _sahi(stock, photo, spec.width_px, spec.height_px))
    slices = _slice_count(width, spec.width_px) * _slice_count(height, spec.height_px)
    for _ in range(repeats):
        for way in ways.values():
            way.measure(image)
    ours, theirs = ways["ours"].boxes, ways["sahi"].boxes
    return {
        "image": f"{width}x{height}",
        "tiles": {"ours": tiles, "sahi": slices + (slices > 1)},
        "ways": {
            name: {"wall_s": way.wall_s, "cpu_s": way.cpu_s, "boxes": len(way.boxes)} for name, way in ways.items()
        },
        "ours_also_sahi": _also(ours, theirs),
        "sahi_also_ours": _also(theirs, ours),
    }


def _ours(detector: OnnxDetector, image: Image, workers: int) -> list[NDArray[np.float64]]:
    return [_labelled(detector, one) for one in detect_image(detector, image, workers=workers)]


def _labelled(detector: OnnxDetector, one: DetectedBox) -> NDArray[np.float64]:
    return np.array([*_corners(one), detector.card.class_names.index(one.class_name)], dtype=np.float64)


def _sahi(wrapped: DetectionModel, image: Image, width: int, height: int) -> list[NDArray[np.float64]]:
    rgb = np.ascontiguousarray(image[:, :, ::-1])
    result = get_sliced_prediction(
        rgb,
        wrapped,
        slice_width=width,
        slice_height=height,
        overlap_width_ratio=OVERLAP_RATIO,
        overlap_height_ratio=OVERLAP_RATIO,
        verbose=0,
    )
    return [np.array([*one.bbox.to_xyxy(), one.category.id], dtype=np.float64) for one in result.object_prediction_list]


def _bare(model: Path, card: ModelCard, *, threads: int, tiles: int, workers: int) -> list[NDArray[np.float64]]:
    """onnxruntime's session alone, on noise; loading it is not counted."""
    session, feed = _session(model, card, threads)
    if workers == 1:
        for _ in range(tiles):
            session.run(None, feed)
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(lambda _: session.run(None, feed), range(tiles)))
    return []


@lru_cache
def _session_of(model: Path, threads: int) -> Any:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    return onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])


def _session(model: Path, card: ModelCard, threads: int) -> tuple[Any, dict[str, NDArray[Any]]]:
    session = _session_of(model, threads)
    takes = session.get_inputs()[0]
    kind = np.float16 if takes.type == "tensor(float16)" else np.float32
    shape = (1, 3, card.input.height_px, card.input.width_px)
    return session, {takes.name: np.random.default_rng(0).random(shape).astype(kind)}


def _slice_count(size: int, tile: int) -> int:
    """How many slices SAHI lays along a side: steps of a tile less its overlap, the last one moved back."""
    step = tile - int(OVERLAP_RATIO * tile)
    return 1 if size <= tile else -(-(size - tile) // step) + 1


def _corners(one: DetectedBox) -> list[float]:
    box = one.box
    return [box.x_px, box.y_px, box.x_px + box.width_px, box.y_px + box.height_px]


def _also(mine: Sequence[NDArray[np.float64]], others: Sequence[NDArray[np.float64]]) -> float | None:
    """The share of ``mine`` (left, top, right, bottom, class) that one of ``others`` covers by IoU 0.5."""
    if not mine:
        return None
    if not others:
        return 0.0
    b = np.array(others)
    found = 0
    for a in mine:
        low, high = np.maximum(a[:2], b[:, :2]), np.minimum(a[2:4], b[:, 2:4])
        both = np.prod(np.clip(high - low, 0, None), axis=1)
        either = np.prod(a[2:4] - a[:2]) + np.prod(b[:, 2:4] - b[:, :2], axis=1) - both
        found += bool(((both / either >= 0.5) & (b[:, 4] == a[4])).any())
    return found / len(mine)


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _table(results: Sequence[tuple[str, dict[str, Any]]]) -> str:
    lines = [
        "| photograph | way | tiles | s, fastest | s, median | CPU s | tiles/s | against SAHI: s, CPU s | boxes |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    agreement = []
    for name, result in results:
        fastest, least = (min(result["ways"]["sahi"][of]) for of in ("wall_s", "cpu_s"))
        for way, took in result["ways"].items():
            tiles = result["tiles"]["sahi" if way.startswith("sahi") else "ours"]
            best, middle, cpu = min(took["wall_s"]), statistics.median(took["wall_s"]), min(took["cpu_s"])
            lines.append(
                f"| {name} {result['image']} | {way} | {tiles} | {best:.2f} | {middle:.2f} | {cpu:.2f} "
                f"| {tiles / best:.1f} | {fastest / best:.2f} x, {least / cpu:.2f} x | {took['boxes']} |"
            )
        ours, theirs = (
            "-" if result[key] is None else f"{result[key]:.0%}" for key in ("ours_also_sahi", "sahi_also_ours")
        )
        agreement.append(f"{name}: of our boxes {ours} are SAHI's too, of SAHI's {theirs} ours (IoU 0.5).")
    return "\n".join([*lines, "", *agreement])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("photographs", type=Path, nargs="+")
    parser.add_argument("--card", type=Path, help="the model's card, if it is not beside it")
    parser.add_argument("--size", help="bring the photographs to WIDTHxHEIGHT first, such as 8000x6000")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path, help="write the figures here too")
    given = parser.parse_args()
    cv2.setNumThreads(given.threads)
    results = []
    for path in given.photographs:
        image = cv2.imread(str(path))
        if image is None:
            sys.exit(f"{path} cannot be read")
        if given.size:
            width, height = (int(value) for value in given.size.split("x"))
            image = cv2.resize(image, (width, height), interpolation=cv2.INTER_CUBIC)
        shown = np.asarray(image, dtype=np.uint8)
        results.append(
            (path.name, compare(shown, given.model, given.card, threads=given.threads, repeats=given.repeats))
        )
    print(f"sahi {sahi.__version__}, {given.model.name}, {given.threads} threads, {given.repeats} repeats\n")
    print(_table(results))
    if given.json:
        given.json.write_text(json.dumps(dict(results), indent=1))


if __name__ == "__main__":
    main()
