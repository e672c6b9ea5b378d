"""Export of the trained network to ONNX: `python -m training.export --weights ... --checkpoint ... --out model.onnx`.

The graph of upstream's file is kept. Only its numbers change: the trained weights, with batch normalisation folded into
the convolutions, three classes instead of eighty, and any batch size instead of one.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from onnx import numpy_helper
from torch import nn

from facadelake.core.arrays import Float32Array
from training.comparison_networks import NETWORKS, create_network, export_by_torch
from training.data.sample import CLASSES
from training.network import ConvNorm, Yolox

INPUT_PX = 416
TOLERANCE = 1e-3  # of decoded outputs in cells and of probabilities; both compute in float32


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--weights", type=Path, required=True, help="upstream's yolox_nano.onnx")
    parser.add_argument("--checkpoint", type=Path, required=True, help="best.pt or checkpoint.pt of training.train")
    parser.add_argument("--out", type=Path, required=True, help="the ONNX file to write")
    parser.add_argument("--network", choices=NETWORKS, default=NETWORKS[0], help="network of the checkpoint")
    options = parser.parse_args()
    network = create_network(options.network, options.weights, len(CLASSES))
    network.load_state_dict(torch.load(options.checkpoint)["mean"])
    is_yolox = isinstance(network, Yolox)
    model = insert_weights(network, onnx.load(options.weights)) if is_yolox else export_by_torch(network, INPUT_PX)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, options.out)
    size_mb = options.out.stat().st_size / 1e6
    print(f"{options.out}: {size_mb:.1f} MB, differs from torch by {measure_difference(network, model):.1e}")


def insert_weights(network: Yolox, upstream: onnx.ModelProto) -> onnx.ModelProto:
    """Insert the network's weights into upstream's graph. Raises ValueError if the outputs of the two differ."""
    model = onnx.ModelProto()
    model.CopyFrom(upstream)
    initializers = {initializer.name: initializer for initializer in model.graph.initializer}
    for node in model.graph.node:
        if node.op_type == "Conv":
            for name, values in zip(
                node.input[1:3], _fold_convolution(network.body.get_submodule(node.name)), strict=True
            ):
                initializers[name].CopyFrom(numpy_helper.from_array(values, name))
    for node in model.graph.node:
        if node.op_type == "Reshape" and node.input[1] in initializers:
            shape = np.array([0, 5 + network.class_count, -1], dtype=np.int64)  # 0: batch size of the input
            initializers[node.input[1]].CopyFrom(numpy_helper.from_array(shape, node.input[1]))
    model.graph.input[0].type.tensor_type.shape.dim[0].dim_param = "batch"
    output = model.graph.output[0].type.tensor_type.shape
    output.dim[0].dim_param = "batch"
    output.dim[2].dim_value = 5 + network.class_count
    del model.graph.value_info[:]
    onnx.checker.check_model(model, full_check=True)
    worst = measure_difference(network, model)
    if worst > TOLERANCE:
        raise ValueError(
            f"the exported model differs from the trained network by {worst:.2g}; the limit is {TOLERANCE}"
        )
    return model


def measure_difference(network: nn.Module, model: onnx.ModelProto) -> float:
    """Largest difference of the outputs of torch and onnxruntime, with batches of 1 and of 8."""
    network.eval()
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    side = model.graph.input[0].type.tensor_type.shape.dim[2].dim_value
    rng = np.random.default_rng(0)
    worst = 0.0
    for batch in (1, 8):
        coarse = rng.integers(0, 256, (batch, 3, side // 16, side // 16)).repeat(16, axis=2).repeat(16, axis=3)
        images = coarse.astype(np.float32)
        with torch.no_grad():
            trained = network(torch.from_numpy(images))
        trained[..., 4:] = trained[..., 4:].sigmoid()
        (exported,) = session.run(None, {model.graph.input[0].name: images})
        worst = max(worst, float(np.abs(exported - trained.numpy()).max()))
    return worst


def _fold_convolution(module: nn.Module) -> tuple[Float32Array, Float32Array]:
    """Weight and bias of a convolution, with its normalisation folded in."""
    if isinstance(module, ConvNorm):
        weight, bias = module.fold()
    else:
        assert isinstance(module, nn.Conv2d) and module.bias is not None
        weight, bias = module.weight, module.bias
    return weight.detach().numpy().astype(np.float32), bias.detach().numpy().astype(np.float32)


if __name__ == "__main__":
    main()
