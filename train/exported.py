"""A training begins with a network that `multicam export` has written, of other classes maybe."""

from __future__ import annotations

from typing import get_args

import torch
from torch import Tensor, nn

from models.blocks import ConvBlock, RepBlock
from models.config import ModelConfig, Size
from models.detector import Detector
from multicam.errors import ModelError
from train.folded import Kernel, NetworkFile, unfold

_PREFIX = "detector."
"""Of the names that parameters keep in the file."""

_MIX = "classifier.mix."
"""The part of the classifier of which the exporter renames what it turns or cuts."""


def exported_size(file: NetworkFile) -> tuple[Size, bool]:
    """Size of an exported network, and whether its convolutions are depthwise.

    Raises:
        ModelError: its numbers have 8 bits.
    """
    theirs = _weights(file)
    sizes = {ModelConfig(1, size).stem_channels: size for size in get_args(Size)}
    return sizes[len(theirs["backbone.stem.conv.weight"])], any(".within." in name for name in theirs)


@torch.no_grad()
def take_exported(file: NetworkFile, detector: Detector, images: Tensor) -> list[str]:
    """Gives a fresh network all weights of an exported one that fit, but for a hybrid neck's attention.

    Args:
        file: as `multicam export` writes it, in single or half precision.
        detector: freshly built.
        images: (B, 3, H, W) pictures as training shows them, for the statistics of the normalisations.

    Returns:
        Names of the tensors that stay as they were, for those of the file have other shapes or are not there.

    Raises:
        ModelError: less than half of the network's numbers are in it, or they have 8 bits.
    """
    size, _ = exported_size(file)
    theirs = _weights(file) | _mix(file)
    state = detector.state_dict(keep_vars=True)

    def kernel(weight: str, bias: str) -> Kernel | None:
        fits = bias in theirs and weight in theirs and theirs[weight].shape == state[weight].shape
        return (theirs[weight], theirs[bias]) if fits else None

    blocks = {
        block: found
        for name, block in detector.named_modules()
        if isinstance(block, ConvBlock) and (found := kernel(f"{name}.conv.weight", f"{name}.conv.bias"))
    }
    features = kernel("classifier.to_features.weight", "classifier.to_features.bias")
    folded: list[nn.Module] = [*blocks] + ([detector.classifier.norm] if features else [])
    taken = {id(t) for module in folded for t in module.state_dict(keep_vars=True).values()}
    plain = [n for n, t in state.items() if id(t) not in taken and n in theirs and theirs[n].shape == t.shape]
    taken |= {id(state[name]) for name in plain}
    share = sum(t.numel() for t in state.values() if id(t) in taken) / sum(t.numel() for t in state.values())
    if share < 0.5:
        raise ModelError(
            f"{file.path} holds a {size} network; only {share:.0%} of the network of this configuration is in it. "
            "Choose the same size, convolutions and neck, or leave `initial` out."
        )
    for name in plain:
        state[name].copy_(theirs[name])
    for module in detector.modules():
        # The file's 3x3 holds the 1x1 beside it, which begins with nothing to add.
        if isinstance(module, RepBlock) and module.wide in blocks and module.narrow is not None:
            assert isinstance(module.narrow.norm, nn.BatchNorm2d)
            nn.init.zeros_(module.narrow.norm.weight)
    unfold(detector, images, blocks, features)
    return [name for name, tensor in state.items() if id(tensor) not in taken]


def _weights(file: NetworkFile) -> dict[str, Tensor]:
    """Single-precision weights by the names of their parameters, those that the exporter renames apart."""
    assert file.metadata is not None, "exported files have metadata"
    if file.metadata.precision == "int8":
        raise ModelError(
            f"{file.path} holds numbers of 8 bits; export the network again with --precision fp32 or fp16."
        )
    named = {name.removeprefix(_PREFIX): t for name, t in file.tensors.items() if name.startswith(_PREFIX)}
    # Halves are wrapped (export.half).
    return {name.replace(".inner.", "."): tensor.float() for name, tensor in named.items()}


def _mix(file: NetworkFile) -> dict[str, Tensor]:
    """Weights that the exporter transposes or cuts into rows, by the names of their parameters."""

    def constants(operator: str, prefix: str) -> list[Tensor]:
        """Those that nodes of a kind take, in the order of the nodes."""
        names = [name for node in file.nodes for name in node.input if node.op_type == operator]
        return [file.tensors[n] for n in names if n in file.tensors and n.startswith(prefix)]

    # Before those of the classifier come those of a hybrid neck's attention, too many to be told apart.
    turned = constants("MatMul", "val_")[-2:]
    scales, shifts = constants("Mul", "select"), constants("Add", "select")
    if [len(found) for found in (turned, scales, shifts)] != [2, 2, 2]:
        return {}
    parts = {"to_parts.weight": turned[0].T, "out.weight": turned[1].T}
    rows = {"gamma": torch.stack(scales), "beta": torch.stack(shifts)}
    return {_MIX + name: tensor for name, tensor in (parts | rows).items()}
