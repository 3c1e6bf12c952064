"""A deployed detector with half-precision numbers where they are safe."""

from __future__ import annotations

import copy

from torch import Tensor, nn

from export.wrapper import DeployDetector


class _ToHalf(nn.Module):
    def __init__(self, inner: nn.Module) -> None:
        super().__init__()
        self.inner = inner.half()

    def forward(self, x: Tensor) -> tuple[Tensor, ...]:
        return self.inner(x.half())


class _ToSingle(nn.Module):
    def __init__(self, inner: nn.Module) -> None:
        super().__init__()
        self.inner = inner

    def forward(self, x: Tensor) -> Tensor:
        return self.inner(x.float())


def halved(single: DeployDetector) -> DeployDetector:
    """A copy whose backbone, neck and branches of the head compute in half precision.

    The last layer of each branch stays single, and all that follows it: half has 11 bits, so it knows a coordinate of
    640 pixels to half a pixel.
    """
    half = copy.deepcopy(single)
    detector = half.detector
    detector.backbone = _ToHalf(detector.backbone)
    detector.neck.half()
    for level in detector.head.levels:
        level.half()
        level.outputs = _ToSingle(level.outputs.float())
        level.classes[-1] = _ToSingle(level.classes[-1].float())
    return half
