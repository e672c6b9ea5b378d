"""YOLOX-nano as a trainable torch module, converted from its ONNX file by onnx2torch.

In the ONNX file batch normalisation is folded into the convolutions. A new normalisation is inserted after each
convolution and initialised so that the output is unchanged; without it training diverges or is slow. At export
(training/export.py) it is folded again, so that upstream's graph can be used with the new weights.
"""

from __future__ import annotations

from pathlib import Path

import onnx
import torch
from onnx2torch import convert
from torch import Tensor, nn

LEVELS = 3
_FOCUS_OUTPUT = "input"  # output of the four slices that move 2 x 2 pixels to channels; in torch they are views


class ConvNorm(nn.Module):
    """A convolution followed by batch normalisation."""

    def __init__(self, conv: nn.Conv2d) -> None:
        super().__init__()
        self.conv = conv
        self.norm = nn.BatchNorm2d(conv.out_channels, eps=1e-3, momentum=0.03)

    def forward(self, x: Tensor) -> Tensor:
        return self.norm(self.conv(x))  # type: ignore[no-any-return]

    def fold(self) -> tuple[Tensor, Tensor]:
        """Weight and bias of the equivalent single convolution, in float64."""
        norm = self.norm
        assert norm.running_var is not None and norm.running_mean is not None
        gain = norm.weight.double() / (norm.running_var.double() + norm.eps).sqrt()
        bias = torch.zeros_like(gain) if self.conv.bias is None else self.conv.bias.double()
        weight = self.conv.weight.double() * gain[:, None, None, None]
        return weight, (bias - norm.running_mean.double()) * gain + norm.bias.double()


class Yolox(nn.Module):
    """Detector: images (b, 3, h, w; BGR, 0 to 255) to raw outputs (b, cells, 5 + classes).

    An output has 2 offsets in cells, 2 logarithms of sizes, and logits of objectness and classes. The cells are in the
    order of levels, then rows.
    """

    def __init__(self, body: nn.Module, class_count: int) -> None:
        super().__init__()
        self.body = body
        self.class_count = class_count

    def forward(self, images: Tensor) -> Tensor:
        top, low = images[..., ::2, :], images[..., 1::2, :]
        x = torch.cat([top[..., ::2], low[..., ::2], top[..., 1::2], low[..., 1::2]], dim=1)
        parts = self.body(x.contiguous(memory_format=torch.channels_last))
        levels = []
        for level in range(LEVELS):
            classes, boxes, objectness = parts[3 * level : 3 * level + 3]
            levels.append(torch.cat([boxes, objectness, classes], dim=1).flatten(2))
        return torch.cat(levels, dim=2).transpose(1, 2)


def list_prediction_nodes(model: onnx.ModelProto) -> list[onnx.NodeProto]:
    """The last convolutions of the graph: classes, boxes and objectness of each level."""
    by_weight = {node.input[1]: node for node in model.graph.node if node.op_type == "Conv"}
    return [by_weight[f"head.{part}_preds.{k}.weight"] for k in range(LEVELS) for part in ("cls", "reg", "obj")]


def load_yolox(weights: Path, *, class_count: int) -> Yolox:
    """Load upstream's ONNX file as a network with ``class_count`` new classes; call ``initialise_norms`` afterwards."""
    model = onnx.shape_inference.infer_shapes(onnx.load(weights))
    outputs = [node.output[0] for node in list_prediction_nodes(model)]
    body = convert(onnx.utils.Extractor(model).extract_model([_FOCUS_OUTPUT], outputs))
    _fuse_silu(body)
    last = {node.name for node in list_prediction_nodes(model)}
    graph_convs = [name for name, module in body.named_children() if isinstance(module, nn.Conv2d)]
    for name in graph_convs:
        conv = body.get_submodule(name)
        assert isinstance(conv, nn.Conv2d)
        if name not in last:
            setattr(body, name, ConvNorm(conv))
        elif conv.out_channels not in (1, 4):
            fresh = nn.Conv2d(conv.in_channels, class_count, 1)
            nn.init.normal_(fresh.weight, std=0.01)
            nn.init.constant_(fresh.bias, -2.0)  # type: ignore[arg-type]
            setattr(body, name, fresh)
    return Yolox(body, class_count).to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]


@torch.no_grad()
def initialise_norms(network: nn.Module, images: Tensor) -> None:
    """Initialise each batch normalisation from the activations of ``images`` such that it leaves them unchanged."""

    def set_to_identity(module: nn.Module, inputs: tuple[Tensor, ...]) -> None:
        assert isinstance(module, nn.BatchNorm2d)
        variance, mean = torch.var_mean(inputs[0], dim=(0, 2, 3), unbiased=False)
        module.running_mean.copy_(mean)  # type: ignore[union-attr]
        module.running_var.copy_(variance)  # type: ignore[union-attr]
        module.weight.copy_((variance + module.eps).sqrt())
        module.bias.copy_(mean)

    norms = [module for module in network.modules() if isinstance(module, nn.BatchNorm2d)]
    hooks = [norm.register_forward_pre_hook(set_to_identity) for norm in norms]
    network.eval()
    network(images)
    for hook in hooks:
        hook.remove()


def _fuse_silu(body: nn.Module) -> None:
    """Replace x * sigmoid(x) by one operation, which needs a third less memory traffic."""
    graph = body.graph  # type: ignore[union-attr]
    for node in list(graph.nodes):
        if node.op != "call_module" or not isinstance(body.get_submodule(node.target), nn.Sigmoid):
            continue
        (product,) = node.users
        name = f"silu_{node.name}"
        body.add_submodule(name, nn.SiLU(inplace=True))  # type: ignore[operator]
        with graph.inserting_after(product):
            silu = graph.call_module(name, (node.args[0],))
        product.replace_all_uses_with(silu)
        graph.erase_node(product)
        graph.erase_node(node)
    graph.eliminate_dead_code()
    body.delete_all_unused_submodules()  # type: ignore[operator]
    body.recompile()  # type: ignore[operator]
