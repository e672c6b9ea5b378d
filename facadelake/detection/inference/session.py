"""An ONNX model in onnxruntime on the CPU: its inputs and outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from facadelake.core.arrays import Float32Array
from facadelake.core.errors import ModelError
from facadelake.detection.card import CardInput

_IMAGE_TYPES: Mapping[str, type] = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
# Values of the key "task" that Ultralytics writes, with what such a model finds.
_OTHER_TASKS = {"obb": "oriented boxes", "pose": "poses", "classify": "classes of whole photographs"}
_SIZE_TYPES: Mapping[str, type] = {**_IMAGE_TYPES, "tensor(int64)": np.int64, "tensor(int32)": np.int32}


class ModelSession:
    """A loaded model: one input of images and, for some models, one of sizes (RT-DETR's orig_target_sizes)."""

    def __init__(self, model: Path, *, threads: int = 0) -> None:
        """Load ``model``; ``threads`` 0: one per core.

        Raises ModelError if the file is not a model or has other inputs than images (and sizes).
        """
        self.model = model
        if not model.is_file():
            raise ModelError(f"model {model} does not exist; correct the detector's path in the portfolio")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # the only common base class of onnxruntime's errors
            raise ModelError(f"model {model} cannot be loaded by onnxruntime: {error}") from error
        inputs = self._session.get_inputs()
        images = [one for one in inputs if one.type in _IMAGE_TYPES and len(one.shape) == 4]
        sizes = [one for one in inputs if one.type in _SIZE_TYPES and len(one.shape) == 2]
        if len(images) != 1 or len(images) + len(sizes) != len(inputs) or len(sizes) > 1:
            raise ModelError(
                f"model {model} has the inputs {[(i.name, i.type, i.shape) for i in inputs]}; supported are one "
                "input of float or float16 (N, 3, height, width) and optionally one of sizes (N, 2)"
            )
        self._images, self._sizes = images[0], sizes[0] if sizes else None
        self.output_names = tuple(str(output.name) for output in self._session.get_outputs())

    def refuse_other_tasks(self) -> None:
        """Raise ModelError where the file's metadata state a task whose outputs no layout reads (Ultralytics)."""
        task = self.metadata.get("task", "")
        if task in _OTHER_TASKS:
            raise ModelError(
                f"model {self.model} is an export of {_OTHER_TASKS[task]} (its metadata state the task {task!r}), "
                "which no layout reads; export a model of the task 'detect' or 'segment'"
            )

    @property
    def metadata(self) -> Mapping[str, str]:
        """The file's custom metadata, free in form."""
        return dict(self._session.get_modelmeta().custom_metadata_map)

    @property
    def input_shape(self) -> tuple[int | None, ...]:
        """Batch, channels, height, width; None where the dimension is symbolic."""
        return tuple(size if isinstance(size, int) and size > 0 else None for size in self._images.shape)

    def check_input(self, spec: CardInput) -> None:
        """Raise ModelError if the model's input does not have the declared size."""
        declared = (1, 3, spec.height_px, spec.width_px)
        if any(size not in (None, wanted) for size, wanted in zip(self.input_shape, declared, strict=True)):
            raise ModelError(
                f"model {self.model} takes an input of shape {self._images.shape}, its card declares {list(declared)} "
                "(1, 3, height_px, width_px); correct the card's input"
            )

    def run(self, values: Float32Array, names: Sequence[str]) -> tuple[Float32Array, ...]:
        """The outputs ``names`` for images (n, 3, height, width). Raises onnxruntime's errors."""
        feed: dict[str, NDArray[Any]] = {self._images.name: values.astype(_IMAGE_TYPES[self._images.type], copy=False)}
        if self._sizes is not None:
            feed[self._sizes.name] = np.ones((len(values), 2), dtype=_SIZE_TYPES[self._sizes.type])
        return tuple(np.asarray(output, dtype=np.float32) for output in self._session.run(list(names), feed))
