"""Small ONNX graphs with fixed outputs, and their cards."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

WIDTH, HEIGHT = 96, 64
CLASSES = ("crack", "car")
STRIDES = (8, 16, 32)


def list_cells() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Cell corners in input pixels (N, 2) and their strides (N,), finest grid first, row by row."""
    corners = [(x, y, s) for s in STRIDES for y in range(0, HEIGHT, s) for x in range(0, WIDTH, s)]
    table = np.array(corners, dtype=np.float64)
    return table[:, :2], table[:, 2]


def save_model(
    path: Path,
    outputs: NDArray[Any] | Mapping[str, NDArray[Any]],
    *,
    shape: tuple[int | str, ...] = (1, 3, HEIGHT, WIDTH),
    kind: int = TensorProto.FLOAT,
    metadata: Mapping[str, str] = MappingProxyType({}),
) -> Path:
    """Save a model with fixed ``outputs``, to which zero times the input's sum is added: one, or one for each name."""
    dtype = helper.tensor_dtype_to_np_dtype(kind)
    named_outputs = outputs if isinstance(outputs, Mapping) else {"output": outputs}
    nodes = [
        helper.make_node("ReduceSum", ["images"], ["sum"], keepdims=0),
        helper.make_node("Mul", ["sum", "zero"], ["nothing"]),
    ]
    constants = [numpy_helper.from_array(np.zeros((), dtype=dtype), "zero")]
    for name, values in named_outputs.items():
        nodes.append(helper.make_node("Add", [f"{name} values", "nothing"], [name]))
        constants.append(numpy_helper.from_array(values.astype(dtype), f"{name} values"))
    graph = helper.make_graph(
        nodes,
        "fixed",
        [helper.make_tensor_value_info("images", kind, shape)],
        [helper.make_tensor_value_info(name, kind, values.shape) for name, values in named_outputs.items()],
        constants,
    )
    return _save(graph, path, metadata)


def save_triple_model(path: Path, outputs: Mapping[str, NDArray[Any]]) -> Path:
    """Save a model of layout rtdetr_triple: boxes (normalised corners) are scaled to its second input, width first."""
    nodes = [
        helper.make_node("ReduceSum", ["images"], ["sum"], keepdims=0),
        helper.make_node("Mul", ["sum", "zero"], ["nothing"]),
        helper.make_node("Cast", ["orig_target_sizes"], ["sizes"], to=TensorProto.FLOAT),
        helper.make_node("Concat", ["sizes", "sizes"], ["four"], axis=1),
        helper.make_node("Unsqueeze", ["four", "one"], ["factors"]),
        helper.make_node("Mul", ["corners", "factors"], ["scaled"]),
        helper.make_node("Add", ["scaled", "nothing"], ["boxes"]),
        helper.make_node("Add", ["score values", "nothing"], ["scores"]),
        helper.make_node("Identity", ["label values"], ["labels"]),
    ]
    constants = {
        "zero": np.zeros((), dtype=np.float32),
        "one": np.array([1], dtype=np.int64),
        "corners": outputs["boxes"].astype(np.float32),
        "score values": outputs["scores"].astype(np.float32),
        "label values": outputs["labels"].astype(np.int64),
    }
    kinds = {"labels": TensorProto.INT64, "boxes": TensorProto.FLOAT, "scores": TensorProto.FLOAT}
    graph = helper.make_graph(
        nodes,
        "triple",
        [
            helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 3, HEIGHT, WIDTH)),
            helper.make_tensor_value_info("orig_target_sizes", TensorProto.INT64, (1, 2)),
        ],
        [helper.make_tensor_value_info(name, kind, outputs[name].shape) for name, kind in kinds.items()],
        [numpy_helper.from_array(values, name) for name, values in constants.items()],
    )
    return _save(graph, path, {})


def save_spot_model(path: Path, *, batch: int | str) -> Path:
    """Save a model of layout nms6 with a box of 2 px at the centroid of brightness of each channel.

    Class 0 is the first channel's, class 1 the second's; the score is the channel's brightest value / 255.
    """
    x = np.tile(np.arange(WIDTH) + 0.5, (HEIGHT, 1)).astype(np.float32)[None, None]
    y = np.tile((np.arange(HEIGHT) + 0.5)[:, None], (1, WIDTH)).astype(np.float32)[None, None]
    constants = {
        "x": x, "y": y, "tiny": np.float32(1e-6), "one": np.float32(1), "white": np.float32(255),
        "pixels": np.array([2, 3]), "last": np.array([2]), "from": np.array([0]), "to": np.array([2]),
        "channels": np.array([1]), "classes": np.array([[[0], [1]]], dtype=np.float32),
    }  # fmt: skip
    nodes = [
        helper.make_node("Slice", ["images", "from", "to", "channels"], ["two"]),
        helper.make_node("ReduceSum", ["two", "pixels"], ["weight"], keepdims=0),
        helper.make_node("Add", ["weight", "tiny"], ["some"]),
    ]
    for axis in ("x", "y"):
        nodes += [
            helper.make_node("Mul", ["two", axis], [f"{axis} weighted"]),
            helper.make_node("ReduceSum", [f"{axis} weighted", "pixels"], [f"{axis} sum"], keepdims=0),
            helper.make_node("Div", [f"{axis} sum", "some"], [f"{axis} flat"]),
            helper.make_node("Unsqueeze", [f"{axis} flat", "last"], [f"{axis} centre"]),
            helper.make_node("Sub", [f"{axis} centre", "one"], [f"{axis} low"]),
            helper.make_node("Add", [f"{axis} centre", "one"], [f"{axis} high"]),
        ]
    nodes += [
        helper.make_node("ReduceMax", ["two"], ["brightest"], axes=[2, 3], keepdims=0),
        helper.make_node("Div", ["brightest", "white"], ["score flat"]),
        helper.make_node("Unsqueeze", ["score flat", "last"], ["score"]),
        helper.make_node("Mul", ["score", "tiny"], ["almost nothing"]),
        helper.make_node("Mul", ["almost nothing", "tiny"], ["nothing"]),
        helper.make_node("Add", ["classes", "nothing"], ["class"]),
        helper.make_node("Concat", ["x low", "y low", "x high", "y high", "score", "class"], ["output"], axis=2),
    ]
    graph = helper.make_graph(
        nodes,
        "spots",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, (batch, 3, HEIGHT, WIDTH))],
        [helper.make_tensor_value_info("output", TensorProto.FLOAT, (batch, 2, 6))],
        [numpy_helper.from_array(np.asarray(values), name) for name, values in constants.items()],
    )
    return _save(graph, path, {})


def _save(graph: Any, path: Path, metadata: Mapping[str, str]) -> Path:
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)
    helper.set_model_props(model, dict(metadata))
    onnx.save(model, path)
    return path


def make_card(layout: str, **changes: Any) -> dict[str, Any]:
    """The content of a card for a model of WIDTH x HEIGHT."""
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


def make_output(layout: str, boxes: list[tuple[int, float, float, float, float, float, int]]) -> NDArray[np.float64]:
    """An output with ``boxes`` (candidate, centre x, centre y, width, height, score, class) in input pixels.

    All other candidates are as large as their cell and have score 0.
    """
    corners, strides = list_cells()
    if layout == "nms6":
        rows = [(x - w / 2, y - h / 2, x + w / 2, y + h / 2, score, c) for _, x, y, w, h, score, c in boxes]
        return np.array([[*rows, (0, 0, 0, 0, -1, -1)]], dtype=np.float64)
    centres, sizes = corners + strides[:, None] / 2, np.column_stack([strides, strides])
    scores = np.zeros((len(corners), len(CLASSES)))
    for candidate, x, y, w, h, score, c in boxes:
        centres[candidate], sizes[candidate], scores[candidate, c] = (x, y), (w, h), score
    if layout == "yolov8":
        return np.column_stack([centres, sizes, scores]).T[None]
    if layout == "yolox":  # the inverse of its decoding
        centres = (centres - corners) / strides[:, None]
        sizes = np.log(sizes / strides[:, None])
    # Objectness 0.8 where there is a box: the product is the score.
    objectness = np.where(scores.max(axis=1) > 0, 0.8, 0.0)
    return np.column_stack([centres, sizes, objectness, scores / 0.8])[None]


QUERIES, GRID = 20, (16, 24)
HalfPlane = tuple[float, float, float]


def make_outputs(
    layout: str,
    boxes: list[tuple[int, float, float, float, float, float, int]],
    planes: Mapping[int, HalfPlane] = MappingProxyType({}),
) -> dict[str, NDArray[np.float64]]:
    """The outputs for ``boxes`` of layouts with several outputs or with normalised boxes.

    ``planes`` (candidate -> a, b, c): its mask is where a*x + b*y + c > 0 in pixels of the input. Prototypes are x, y
    and 1, so such masks are exact; a candidate without a plane has an empty mask.
    """
    size = np.array([WIDTH, HEIGHT] * 2, dtype=np.float64)
    rows, columns = GRID
    x, y = np.meshgrid((np.arange(columns) + 0.5) * WIDTH / columns, (np.arange(rows) + 0.5) * HEIGHT / rows)
    prototypes = np.stack([x, y, np.ones_like(x)])
    if layout.endswith("_seg") and layout != "rfdetr_seg":
        table = make_output(layout.removesuffix("_seg"), boxes)[0]
        by_candidate = table.T if layout == "yolov8_seg" else table
        coefficients = np.tile([0.0, 0.0, -1.0], (len(by_candidate), 1))
        for candidate, plane in planes.items():
            at = [box[0] for box in boxes].index(candidate) if layout == "nms6_seg" else candidate
            coefficients[at] = plane
        whole = np.column_stack([by_candidate, coefficients])
        return {"output0": (whole.T if layout == "yolov8_seg" else whole)[None], "output1": prototypes[None]}
    centred = np.tile([0.5, 0.5, 0.1, 0.2], (QUERIES, 1))
    scores = np.full((QUERIES, len(CLASSES)), 1e-4)
    for candidate, cx, cy, w, h, score, c in boxes:
        query = candidate % QUERIES
        centred[query], scores[query, c] = np.array([cx, cy, w, h]) / size, score
    logits = np.log(scores) - np.log1p(-scores)
    if layout == "rtdetr":
        return {"logits": logits[None], "pred_boxes": centred[None]}
    if layout == "rtdetr_rows":
        return {"output": np.column_stack([centred, scores.max(axis=1), scores.argmax(axis=1)])[None]}
    if layout == "rtdetr_triple":
        corners = np.column_stack([centred[:, :2] - centred[:, 2:] / 2, centred[:, :2] + centred[:, 2:] / 2])
        return {"labels": scores.argmax(axis=1)[None], "boxes": corners[None], "scores": scores.max(axis=1)[None]}
    if layout in ("map", "map_logits"):
        maps = np.full((len(CLASSES), *GRID), 0.01)
        for _, cx, cy, w, h, score, c in boxes:
            maps[c, (np.abs(y - cy) < h / 2) & (np.abs(x - cx) < w / 2)] = score
        return {"output": (maps if layout == "map" else np.log(maps) - np.log1p(-maps))[None]}
    # The last column of RF-DETR means no object; its high logits must be ignored.
    nothing = np.full((QUERIES, 1), 6.0)
    given = {"dets": centred[None], "labels": np.column_stack([logits, nothing])[None]}
    if layout == "rfdetr_seg":
        masks = np.full((QUERIES, *GRID), -1.0)
        for candidate, plane in planes.items():
            masks[candidate % QUERIES] = np.tensordot(plane, prototypes, axes=1)
        given["masks"] = masks[None]
    return given
