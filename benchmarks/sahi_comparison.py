"""Detection in large photographs by ``detect_image`` and by SAHI, with the same model, photographs, tiles and threads.

    uv venv build/sahi && uv pip install -p build/sahi sahi onnxruntime scipy scikit-image pydantic filelock
    PYTHONPATH=. build/sahi/bin/python -m benchmarks.sahi_comparison data/detector/facadelake-nano.onnx A.JPG B.JPG
    PYTHONPATH=. build/sahi/bin/python -m benchmarks.sahi_comparison data/detector/facadelake-nano.onnx A.JPG \
        --size 8000x6000

SAHI (MIT) is not a dependency of Facadelake; without it the benchmark exits with a message. Three methods are measured
in alternation, ``--repeats`` times, on decoded photographs:

bare   the onnxruntime session alone, on as many inputs as ``detect_image`` has tiles, as an upper limit: once with all
       threads for each input, once with one thread for each input and as many inputs at once
ours   ``detect_image``: tiling, inference and merging across the borders of tiles
sahi   ``get_sliced_prediction``: slices of the same size and overlap, and the whole photograph, merged by its default
       (greedy NMM on IOS). The adapter below uses our preprocessing and output layout, so that the results differ by
       slicing and merging only. A model of layout yolov8 is also measured with SAHI's own adapter, where
       ``ultralytics`` (AGPL-3.0) is installed

Prints Markdown: seconds per photograph (fastest and median), CPU seconds (which depend little on the load of the
machine), tiles per second, number of boxes, and the share of the boxes of each method that the other has too (IoU 0.5).
There is no truth in this benchmark: accuracy is measured by ``facadelake evaluate-detector`` and by
``benchmarks.detector seams``.
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

from facadelake.core.arrays import Float64N, UInt8Image
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
    sys.exit(
        "sahi is not installed; it is not a dependency of facadelake. The head of this file describes a venv with it"
    )


class OnnxSliceModel(DetectionModel):  # type: ignore[misc]
    """Adapter of an OnnxDetector to SAHI's model class; one slice per inference, as in SAHI's own adapters."""

    def set_model(self, model: Any, **kwargs: Any) -> None:
        """Set the detector and its classes (called by SAHI)."""
        self.model = model
        self.category_mapping = {str(i): name for i, name in enumerate(model.card.class_names)}
        self.ids = {name: i for i, name in enumerate(model.card.class_names)}

    def set_device(self, device: str | None = None) -> None:
        """Use the CPU (called by SAHI)."""
        self.device = "cpu"

    def perform_inference(self, image: UInt8Image) -> None:
        """Detect in one slice (h, w, 3: red, green, blue; called by SAHI)."""
        self._original_predictions = self.model.detect(np.ascontiguousarray(image[:, :, ::-1]))  # SAHI passes RGB

    def _create_object_prediction_list_from_original_predictions(
        self, shift_amount_list: Any = None, full_shape_list: Any = None
    ) -> None:
        shift = fix_shift_amount_list(shift_amount_list)[0]
        shape = (fix_full_shape_list(full_shape_list) or [None])[0]
        self._object_prediction_list_per_image = [
            [
                ObjectPrediction(
                    bbox=_list_corners(one),
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
class TimedMethod:
    """A detection method, the seconds of each repetition, and the last boxes (5,: left, top, right, bottom, class)."""

    run: Callable[[UInt8Image], Sequence[Float64N]]
    wall_s: list[float] = field(default_factory=list)
    cpu_s: list[float] = field(default_factory=list)
    boxes: Sequence[Float64N] = ()

    def measure(self, image: UInt8Image) -> None:
        """Run the method once and record its seconds."""
        wall, cpu = time.perf_counter(), _read_cpu_s()
        self.boxes = self.run(image)
        self.wall_s.append(time.perf_counter() - wall)
        self.cpu_s.append(_read_cpu_s() - cpu)


def compare_methods(image: UInt8Image, model: Path, card: Path | None, *, threads: int, repeats: int) -> dict[str, Any]:
    """Measure all methods on one photograph (h, w, 3: blue, green, red), in alternation.

    Args:
        image: the photograph.
        model: ONNX file.
        card: its card; None for the card beside it.
        threads: number of threads of each method.
        repeats: number of repetitions.

    Returns:
        The figures, as written by ``--json``.
    """
    single_threaded = load_detector(model, card, threads=1)
    multi_threaded = load_detector(model, card, threads=threads)
    spec = single_threaded.card.input
    height, width = image.shape[:2]
    passes = plan_tile_passes(spec, width_px=width, height_px=height)
    tiles = sum(len(tile_pass.tiles) for tile_pass in passes)
    model_adapter = OnnxSliceModel(
        model=multi_threaded, confidence_threshold=single_threaded.card.score_threshold, image_size=spec.width_px
    )
    # detect_image is faster with single-threaded sessions, SAHI with one session of all threads.
    methods = {
        "bare": TimedMethod(
            run=lambda _: _run_session(model, single_threaded.card, threads=threads, tiles=tiles, workers=1)
        ),
        "bare, a thread each": TimedMethod(
            run=lambda _: _run_session(model, single_threaded.card, threads=1, tiles=tiles, workers=threads)
        ),
        "ours": TimedMethod(run=lambda photo: _run_facadelake(single_threaded, photo, threads)),
        "sahi": TimedMethod(run=lambda photo: _run_sahi(model_adapter, photo, spec.width_px, spec.height_px)),
    }
    for count in {1, threads}:
        _create_session(model, count)
    if single_threaded.card.output.layout is OutputLayout.YOLOV8 and find_spec("ultralytics"):
        ultralytics_model = AutoDetectionModel.from_pretrained(
            "ultralytics",
            model_path=str(model),
            confidence_threshold=single_threaded.card.score_threshold,
            image_size=spec.width_px,
            device="cpu",
        )
        methods["sahi, its own adapter"] = TimedMethod(
            run=lambda photo: _run_sahi(ultralytics_model, photo, spec.width_px, spec.height_px)
        )
    slices = _count_slices(width, spec.width_px) * _count_slices(height, spec.height_px)
    for _ in range(repeats):
        for method in methods.values():
            method.measure(image)
    ours, theirs = methods["ours"].boxes, methods["sahi"].boxes
    return {
        "image": f"{width}x{height}",
        "tiles": {"ours": tiles, "sahi": slices + (slices > 1)},
        "methods": {
            name: {"wall_s": method.wall_s, "cpu_s": method.cpu_s, "boxes": len(method.boxes)}
            for name, method in methods.items()
        },
        "ours_also_sahi": _compute_covered_share(ours, theirs),
        "sahi_also_ours": _compute_covered_share(theirs, ours),
    }


def _run_facadelake(detector: OnnxDetector, image: UInt8Image, workers: int) -> list[Float64N]:
    return [_create_labelled_box(detector, one) for one in detect_image(detector, image, workers=workers)]


def _create_labelled_box(detector: OnnxDetector, one: DetectedBox) -> Float64N:
    return np.array([*_list_corners(one), detector.card.class_names.index(one.class_name)], dtype=np.float64)


def _run_sahi(model_adapter: DetectionModel, image: UInt8Image, width: int, height: int) -> list[Float64N]:
    rgb = np.ascontiguousarray(image[:, :, ::-1])
    result = get_sliced_prediction(
        rgb,
        model_adapter,
        slice_width=width,
        slice_height=height,
        overlap_width_ratio=OVERLAP_RATIO,
        overlap_height_ratio=OVERLAP_RATIO,
        verbose=0,
    )
    return [np.array([*one.bbox.to_xyxy(), one.category.id], dtype=np.float64) for one in result.object_prediction_list]


def _run_session(model: Path, card: ModelCard, *, threads: int, tiles: int, workers: int) -> list[Float64N]:
    """Run the onnxruntime session alone, on noise; loading is not measured."""
    session, feed = _prepare_session(model, card, threads)
    if workers == 1:
        for _ in range(tiles):
            session.run(None, feed)
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(lambda _: session.run(None, feed), range(tiles)))
    return []


@lru_cache
def _create_session(model: Path, threads: int) -> Any:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    return onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])


def _prepare_session(model: Path, card: ModelCard, threads: int) -> tuple[Any, dict[str, NDArray[Any]]]:
    session = _create_session(model, threads)
    model_input = session.get_inputs()[0]
    kind = np.float16 if model_input.type == "tensor(float16)" else np.float32
    shape = (1, 3, card.input.height_px, card.input.width_px)
    return session, {model_input.name: np.random.default_rng(0).random(shape).astype(kind)}


def _count_slices(size: int, tile: int) -> int:
    """Number of SAHI's slices along a side: steps of a tile less its overlap, the last slice moved inside."""
    step = tile - int(OVERLAP_RATIO * tile)
    return 1 if size <= tile else -(-(size - tile) // step) + 1


def _list_corners(one: DetectedBox) -> list[float]:
    box = one.box
    return [box.x_px, box.y_px, box.x_px + box.width_px, box.y_px + box.height_px]


def _compute_covered_share(mine: Sequence[Float64N], others: Sequence[Float64N]) -> float | None:
    """Share of ``mine`` (left, top, right, bottom, class) with a box of the same class and IoU 0.5 in ``others``."""
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


def _read_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _format_table(results: Sequence[tuple[str, dict[str, Any]]]) -> str:
    lines = [
        "| photograph | method | tiles | s, fastest | s, median | CPU s | tiles/s | against SAHI: s, CPU s | boxes |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    agreement = []
    for name, result in results:
        fastest, least = (min(result["methods"]["sahi"][of]) for of in ("wall_s", "cpu_s"))
        for method, spent in result["methods"].items():
            tiles = result["tiles"]["sahi" if method.startswith("sahi") else "ours"]
            best, median, cpu = min(spent["wall_s"]), statistics.median(spent["wall_s"]), min(spent["cpu_s"])
            lines.append(
                f"| {name} {result['image']} | {method} | {tiles} | {best:.2f} | {median:.2f} | {cpu:.2f} "
                f"| {tiles / best:.1f} | {fastest / best:.2f} x, {least / cpu:.2f} x | {spent['boxes']} |"
            )
        ours, theirs = (
            "-" if result[key] is None else f"{result[key]:.0%}" for key in ("ours_also_sahi", "sahi_also_ours")
        )
        agreement.append(f"{name}: {ours} of our boxes are also SAHI's, {theirs} of SAHI's are also ours (IoU 0.5).")
    return "\n".join([*lines, "", *agreement])


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("photographs", type=Path, nargs="+")
    parser.add_argument("--card", type=Path, help="card of the model, if it is not beside it")
    parser.add_argument("--size", help="resize the photographs to WIDTHxHEIGHT first, such as 8000x6000")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    cv2.setNumThreads(options.threads)
    results = []
    for path in options.photographs:
        image = cv2.imread(str(path))
        if image is None:
            sys.exit(f"{path} cannot be read")
        if options.size:
            width, height = (int(value) for value in options.size.split("x"))
            image = cv2.resize(image, (width, height), interpolation=cv2.INTER_CUBIC)
        pixels = np.asarray(image, dtype=np.uint8)
        results.append(
            (
                path.name,
                compare_methods(pixels, options.model, options.card, threads=options.threads, repeats=options.repeats),
            )
        )
    print(f"sahi {sahi.__version__}, {options.model.name}, {options.threads} threads, {options.repeats} repeats\n")
    print(_format_table(results))
    if options.json:
        options.json.write_text(json.dumps(dict(results), indent=1))


if __name__ == "__main__":
    main()
