"""Networks in ONNX files, as a start: normalisations that were folded into their convolutions are unfolded again.

Training wants normalisations: they get the statistics of pictures at hand, and a scale and shift under which the
network computes what the file computes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import onnx
import torch
from google.protobuf.message import DecodeError
from onnx import numpy_helper
from torch import Tensor, nn

from models.blocks import ConvBlock
from models.detector import Detector
from multicam.errors import DataError
from multicam.files import require_file
from multicam.inference.metadata import NetworkMetadata
from multicam.inference.session import METADATA_KEY

Kernel = tuple[Tensor, Tensor]
"""Weight (outputs, inputs / groups, height, width), or (outputs, inputs), and bias (outputs,)."""

_ROWS = 10
"""Best cells of each picture, about its objects, that give the statistics of the coordinate classifier."""


def is_network_file(path: Path) -> bool:
    """Whether a path names such a file, and not a checkpoint's folder."""
    return path.suffix == ".onnx"


@dataclass(frozen=True, eq=False)
class NetworkFile:
    """An ONNX file.

    Attributes:
        tensors: its constants by name, in their order.
        metadata: what `multicam export` says of a file that it wrote.
    """

    path: Path
    nodes: tuple[onnx.NodeProto, ...]
    tensors: dict[str, Tensor]
    metadata: NetworkMetadata | None

    @classmethod
    def read(cls, path: Path) -> NetworkFile:
        """Reads a file.

        Raises:
            DataError: no such file, or no ONNX file.
            ModelError: what it says of itself is damaged.
        """
        require_file(path, "ONNX file to begin with")
        try:
            model = onnx.load(path)
        except DecodeError as error:
            raise DataError(f"{path} is no ONNX file ({error}); download or export it again.") from error
        tensors = {t.name: torch.from_numpy(numpy_helper.to_array(t).copy()) for t in model.graph.initializer}
        text = {entry.key: entry.value for entry in model.metadata_props}.get(METADATA_KEY)
        metadata = None if text is None else NetworkMetadata.from_json(text, str(path))
        return cls(path, tuple(model.graph.node), tensors, metadata)


@torch.no_grad()
def unfold(detector: Detector, images: Tensor, blocks: Mapping[ConvBlock, Kernel], features: Kernel | None) -> None:
    """Gives convolutions the weights of folded ones, and their normalisations what was folded.

    Args:
        images: (B, 3, H, W) pictures as training shows them, for the statistics.
        blocks: what each block is to compute.
        features: the same of the layer before the classifier's normalisation; None leaves it alone.
    """
    norms = {block.norm: bias for block, (_, bias) in blocks.items()}
    for block, (weight, _) in blocks.items():
        block.conv.weight.copy_(weight)
    if features is not None:
        detector.classifier.to_features.weight.copy_(features[0])
        norms[detector.classifier.norm] = features[1]
    hooks = [
        norm.register_forward_pre_hook(partial(_normalise, bias=bias.to(images.device))) for norm, bias in norms.items()
    ]
    training = detector.training
    raw = detector.eval()(images.float())
    detector.decode(raw, _ROWS)
    detector.train(training)
    for hook in hooks:
        hook.remove()


def _normalise(norm: nn.Module, inputs: tuple[Tensor], *, bias: Tensor) -> None:
    """Before a normalisation runs: statistics of what it is given, and outputs that are its inputs plus the bias."""
    assert isinstance(norm, nn.BatchNorm1d | nn.BatchNorm2d)
    assert norm.running_mean is not None and norm.running_var is not None
    var, mean = torch.var_mean(inputs[0], dim=[d for d in range(inputs[0].ndim) if d != 1], correction=0)
    norm.running_mean.copy_(mean)
    norm.running_var.copy_(var)
    norm.weight.copy_((var + norm.eps).sqrt())
    norm.bias.copy_(bias + mean)
