"""Tiny ONNX graphs that answer with a given array, and the cards that go with them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

WIDTH, HEIGHT = 96, 64
CLASSES = ("crack", "car")
STRIDES = (8, 16, 32)


def cells() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Cell corners in input pixels (N, 2) and their strides (N,), finest grid first, row by row."""
    corners = [(x, y, s) for s in STRIDES for y in range(0, HEIGHT, s) for x in range(0, WIDTH, s)]
    table = np.array(corners, dtype=np.float64)
    return table[:, :2], table[:, 2]


def save_model(
    path: Path,
    answer: NDArray[Any],
    *,
    shape: tuple[int | str, ...] = (1, 3, HEIGHT, WIDTH),
    kind: int = TensorProto.FLOAT,
) -> Path:
    """A model that adds zero times its input's sum to ``answer``."""
    dtype = helper.tensor_dtype_to_np_dtype(kind)
    nodes = [
        helper.make_node("ReduceSum", ["images"], ["sum"], keepdims=0),
        helper.make_node("Mul", ["sum", "zero"], ["nothing"]),
        helper.make_node("Add", ["answer", "nothing"], ["output"]),
    ]
    graph = helper.make_graph(
        nodes,
        "fixed",
        [helper.make_tensor_value_info("images", kind, shape)],
        [helper.make_tensor_value_info("output", kind, answer.shape)],
        [
            numpy_helper.from_array(answer.astype(dtype), "answer"),
            numpy_helper.from_array(np.zeros((), dtype=dtype), "zero"),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)
    onnx.save(model, path)
    return path


def card(layout: str, **changes: Any) -> dict[str, Any]:
    """A card's content for a model of WIDTH x HEIGHT."""
    content = {
        "name": "fixed",
        "licence": "Apache-2.0",
        "class_names": list(CLASSES),
        "input": {"width_px": WIDTH, "height_px": HEIGHT, "colour": "rgb", "scale": 1.0, "resize": "letterbox_corner"},
        "output": {"layout": layout},
        "score_threshold": 0.25,
        "nms_iou": 0.5,
    }
    return {**content, **changes}


def answer(layout: str, boxes: list[tuple[int, float, float, float, float, float, int]]) -> NDArray[np.float64]:
    """An output that holds ``boxes`` (candidate, centre x, centre y, width, height, score, class) in input pixels.

    All other candidates are as large as their cell and have score 0.
    """
    corners, strides = cells()
    if layout == "nms6":
        rows = [(x - w / 2, y - h / 2, x + w / 2, y + h / 2, score, c) for _, x, y, w, h, score, c in boxes]
        return np.array([[*rows, (0, 0, 0, 0, -1, -1)]], dtype=np.float64)
    centres, sizes = corners + strides[:, None] / 2, np.column_stack([strides, strides])
    scores = np.zeros((len(corners), len(CLASSES)))
    for candidate, x, y, w, h, score, c in boxes:
        centres[candidate], sizes[candidate], scores[candidate, c] = (x, y), (w, h), score
    if layout == "yolov8":
        return np.column_stack([centres, sizes, scores]).T[None]
    if layout == "yolox":  # the inverse of its decoding, by hand
        centres = (centres - corners) / strides[:, None]
        sizes = np.log(sizes / strides[:, None])
    # Objectness 0.8 where there is a box: the product is the score.
    objectness = np.where(scores.max(axis=1) > 0, 0.8, 0.0)
    return np.column_stack([centres, sizes, objectness, scores / 0.8])[None]
