"""Backbone and neck begin with a YOLOX that its authors have published, as ONNX, trained on COCO."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

import torch
from torch import Tensor

from models.blocks import ConvBlock
from models.config import ModelConfig, Size
from models.detector import OFFSET, SCALE, Detector
from models.neck import Pafpn
from multicam.errors import DataError, ModelError
from train.folded import Kernel, NetworkFile, unfold


def published_size(file: NetworkFile) -> tuple[Size, bool]:
    """Size of a published YOLOX, and whether its convolutions are depthwise.

    Raises:
        DataError: not a YOLOX.
    """
    return _size(file, _kernels(file))


@torch.no_grad()
def take_published(file: NetworkFile, detector: Detector, images: Tensor) -> list[str]:
    """Gives backbone and neck the weights of a published YOLOX of the same size.

    With a neck of another kind the backbone alone.

    Args:
        file: yolox_nano.onnx and so on.
        detector: freshly built.
        images: (B, 3, H, W) pictures as training shows them, for the statistics of the normalisations.

    Returns:
        Names of the tensors that stay as they were.

    Raises:
        DataError: not a YOLOX.
        ModelError: a network of another size.
    """
    config, blocks, kernels = detector.config, _blocks(detector), _kernels(file)
    size, depthwise = _size(file, kernels)
    if (size, depthwise) != (config.size, config.depthwise):
        raise ModelError(
            f"{file.path} holds a {size} network; to begin with it, set network.size: {size} and network.depthwise: "
            f"{str(depthwise).lower()}, not {config.size} and {str(config.depthwise).lower()}."
        )
    kernels[0] = _without_space_to_depth(*kernels[0])
    # The rest of the file is its head.
    kernels = kernels[: len(blocks)]
    if [weight.shape for weight, _ in kernels] != [block.conv.weight.shape for block in blocks]:
        raise _not_yolox(file, "its convolutions are not those of backbone and neck")
    unfold(detector, images, dict(zip(blocks, kernels, strict=True)), None)
    taken = {id(tensor) for block in blocks for tensor in block.state_dict(keep_vars=True).values()}
    return [name for name, tensor in detector.state_dict(keep_vars=True).items() if id(tensor) not in taken]


def _blocks(detector: Detector) -> list[ConvBlock]:
    """In the order in which YOLOX computes them, which is that of our modules."""
    neck = detector.neck
    shared = [m for name, m in neck.named_children() if name != "projectors"] if isinstance(neck, Pafpn) else []
    return [m for part in (detector.backbone, *shared) for m in part.modules() if isinstance(m, ConvBlock)]


def _kernels(file: NetworkFile) -> list[Kernel]:
    nodes = [node for node in file.nodes if node.op_type == "Conv"]
    try:
        return [(file.tensors[node.input[1]], file.tensors[node.input[2]]) for node in nodes]
    except (IndexError, KeyError) as error:
        raise _not_yolox(file, f"{type(error).__name__}: {error}") from error


def _size(file: NetworkFile, kernels: Sequence[Kernel]) -> tuple[Size, bool]:
    """Size, and whether the convolutions are depthwise."""
    shapes = [weight.shape for weight, _ in kernels[:2]]
    sizes = {ModelConfig(1, size).stem_channels: size for size in get_args(Size)}
    if len(shapes) < 2 or shapes[0][1:] != (12, 3, 3) or shapes[0][0] not in sizes:
        raise _not_yolox(file, "it does not begin with the four pixels of each block")
    return sizes[shapes[0][0]], shapes[1][1] == 1


def _not_yolox(file: NetworkFile, what: str) -> DataError:
    return DataError(f"{file.path} is no ONNX file of a YOLOX as its authors publish it ({what}); download it again.")


def _without_space_to_depth(weight: Tensor, bias: Tensor) -> Kernel:
    """(C, 12, 3, 3) of BGR pixels, four of a block side by side, to (C, 3, 6, 6) of our normalised RGB.

    The channels are the blocks' upper left, lower left, upper right and lower right pixel, each blue, green, red.
    """
    wide = weight.new_empty(len(weight), 3, 6, 6)
    for pixel, (down, right) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
        wide[:, :, down::2, right::2] = weight[:, 3 * pixel : 3 * pixel + 3].flip(1)
    return wide * SCALE, bias + OFFSET * wide.sum(dim=(1, 2, 3))
