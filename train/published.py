"""Backbone and neck begin with a YOLOX that its authors have published, as ONNX, trained on COCO.

The published files hold convolutions into which the normalisations were folded. Training wants normalisations: they get
the statistics of pictures at hand, and a scale and shift under which the network computes what the file computes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import get_args

import onnx
import torch
from google.protobuf.message import DecodeError
from onnx import numpy_helper
from torch import Tensor, nn

from models.blocks import ConvBlock
from models.config import ModelConfig, Size
from models.detector import OFFSET, SCALE, Detector
from models.neck import Pafpn
from multicam.errors import DataError, ModelError
from multicam.files import require_file

Kernel = tuple[Tensor, Tensor]
"""Weight (outputs, inputs / groups, height, width) and bias (outputs,) of a convolution."""


def is_published(path: Path) -> bool:
    """Whether a path names such a file, and not a checkpoint's folder."""
    return path.suffix == ".onnx"


def published_size(path: Path) -> tuple[Size, bool]:
    """Size of a published YOLOX, and whether its convolutions are depthwise.

    Raises:
        DataError: no such file, or not a YOLOX.
    """
    return _size(path, _kernels(path))


@torch.no_grad()
def take_published(path: Path, detector: Detector, images: Tensor) -> list[str]:
    """Gives backbone and neck the weights of a published YOLOX of the same size.

    With a neck of another kind the backbone alone.

    Args:
        path: yolox_nano.onnx and so on.
        detector: freshly built.
        images: (B, 3, H, W) pictures as training shows them, for the statistics of the normalisations.

    Returns:
        Names of the tensors that stay as they were.

    Raises:
        DataError: no such file, or not a YOLOX.
        ModelError: a network of another size.
    """
    config, blocks, kernels = detector.config, _blocks(detector), _kernels(path)
    size, depthwise = _size(path, kernels)
    if (size, depthwise) != (config.size, config.depthwise):
        raise ModelError(
            f"{path} holds a {size} network; to begin with it, set network.size: {size} and network.depthwise: "
            f"{str(depthwise).lower()}, not {config.size} and {str(config.depthwise).lower()}."
        )
    kernels[0] = _without_space_to_depth(*kernels[0])
    # The rest of the file is its head.
    kernels = kernels[: len(blocks)]
    if [weight.shape for weight, _ in kernels] != [block.conv.weight.shape for block in blocks]:
        raise _not_yolox(path, "its convolutions are not those of backbone and neck")
    for block, (weight, _) in zip(blocks, kernels, strict=True):
        block.conv.weight.copy_(weight)
    hooks = [
        block.norm.register_forward_pre_hook(partial(_normalise, bias=bias.to(images.device)))
        for block, (_, bias) in zip(blocks, kernels, strict=True)
    ]
    training = detector.training
    detector.eval()(images.float())
    detector.train(training)
    for hook in hooks:
        hook.remove()
    taken = {id(tensor) for block in blocks for tensor in block.state_dict(keep_vars=True).values()}
    return [name for name, tensor in detector.state_dict(keep_vars=True).items() if id(tensor) not in taken]


def _blocks(detector: Detector) -> list[ConvBlock]:
    """In the order in which YOLOX computes them, which is that of our modules."""
    neck = detector.neck
    shared = [m for name, m in neck.named_children() if name != "projectors"] if isinstance(neck, Pafpn) else []
    return [m for part in (detector.backbone, *shared) for m in part.modules() if isinstance(m, ConvBlock)]


def _kernels(path: Path) -> list[Kernel]:
    require_file(path, "published YOLOX")
    try:
        graph = onnx.load(path).graph
        tensors = {t.name: torch.from_numpy(numpy_helper.to_array(t).copy()) for t in graph.initializer}
        return [(tensors[node.input[1]], tensors[node.input[2]]) for node in graph.node if node.op_type == "Conv"]
    except (DecodeError, IndexError, KeyError) as error:
        raise _not_yolox(path, f"{type(error).__name__}: {error}") from error


def _size(path: Path, kernels: Sequence[Kernel]) -> tuple[Size, bool]:
    """Size, and whether the convolutions are depthwise."""
    shapes = [weight.shape for weight, _ in kernels[:2]]
    sizes = {ModelConfig(1, size).stem_channels: size for size in get_args(Size)}
    if len(shapes) < 2 or shapes[0][1:] != (12, 3, 3) or shapes[0][0] not in sizes:
        raise _not_yolox(path, "it does not begin with the four pixels of each block")
    return sizes[shapes[0][0]], shapes[1][1] == 1


def _not_yolox(path: Path, what: str) -> DataError:
    return DataError(f"{path} is no ONNX file of a YOLOX as its authors publish it ({what}); download it again.")


def _without_space_to_depth(weight: Tensor, bias: Tensor) -> Kernel:
    """(C, 12, 3, 3) of BGR pixels, four of a block side by side, to (C, 3, 6, 6) of our normalised RGB.

    The channels are the blocks' upper left, lower left, upper right and lower right pixel, each blue, green, red.
    """
    wide = weight.new_empty(len(weight), 3, 6, 6)
    for pixel, (down, right) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
        wide[:, :, down::2, right::2] = weight[:, 3 * pixel : 3 * pixel + 3].flip(1)
    return wide * SCALE, bias + OFFSET * wide.sum(dim=(1, 2, 3))


def _normalise(norm: nn.BatchNorm2d, inputs: tuple[Tensor], *, bias: Tensor) -> None:
    """Before a normalisation runs: statistics of what it is given, and outputs that are its inputs plus the bias."""
    var, mean = torch.var_mean(inputs[0], dim=(0, 2, 3), correction=0)
    assert norm.running_mean is not None and norm.running_var is not None
    norm.running_mean.copy_(mean)
    norm.running_var.copy_(var)
    norm.weight.copy_((var + norm.eps).sqrt())
    norm.bias.copy_(bias + mean)
