"""Head of RTMO (Lu et al. 2023, arXiv 2312.07526): per cell a class, a box, and a vector that holds the pose."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn

from models.blocks import ConvBlock
from models.config import ModelConfig

_PRIOR = 0.01
"""Probability of an object that every cell starts with, so that background does not drown the first steps."""

_FIRST_SIDE = 4.0
"""Strides that every box is wide and high at first; 1 - IoU^2 has little gradient for boxes far too small."""

_LONGEST = 6.0
"""Bound on log(size / stride): a box of 400 strides; keeps exp finite."""


class LevelOutputs(NamedTuple):
    """Outputs of one level, cells along axis 1 (row by row), still relative to cell and stride."""

    class_logits: Tensor
    boxes: Tensor
    proxy: Tensor
    visibility_logits: Tensor
    pose_vectors: Tensor


class HeadLevel(nn.Module):
    """Branches of one stride; half of the input channels feed the classes, the other half the pose."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        half, pose = config.head_channels // 2, config.pose_channels
        self.classes = nn.Sequential(
            ConvBlock(half, half, 3),
            ConvBlock(half, half, 3),
            nn.Conv2d(half, config.num_classes, 1),
        )
        self.pose = nn.Sequential(
            ConvBlock(half, pose, 3),
            *(ConvBlock(pose, pose, 3, groups=config.pose_groups) for _ in range(3)),
        )
        self.sizes = (4, 2 * config.num_keypoints, config.num_keypoints, config.pose_vector)
        self.outputs = nn.Conv2d(pose, sum(self.sizes), 1)
        self._initialise()

    def _initialise(self) -> None:
        classes = self.classes[-1]
        assert isinstance(classes, nn.Conv2d) and classes.bias is not None and self.outputs.bias is not None
        nn.init.normal_(classes.weight, std=0.01)
        nn.init.constant_(classes.bias, -math.log((1 - _PRIOR) / _PRIOR))
        nn.init.zeros_(self.outputs.bias)
        nn.init.constant_(self.outputs.bias[2:4], math.log(_FIRST_SIDE))

    def forward(self, x: Tensor) -> LevelOutputs:
        """(B, head_channels, h, w) to outputs (B, h w, ...)."""
        for_classes, for_pose = x.chunk(2, dim=1)
        rest = _cells_last(self.outputs(self.pose(for_pose)))
        box, proxy, visibility, vector = rest.split(self.sizes, dim=2)
        return LevelOutputs(_cells_last(self.classes(for_classes)), box, proxy, visibility, vector)


class Head(nn.Module):
    """All levels, decoded to pixels and joined along the cells."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.strides = config.strides
        self.levels = nn.ModuleList(HeadLevel(config) for _ in config.strides)

    def forward(self, features: list[Tensor]) -> tuple[LevelOutputs, Tensor, Tensor]:
        """Features per stride to outputs in pixels (proxy (B, A, K, 2)), centres (A, 2) and strides (A,)."""
        joined: list[LevelOutputs] = []
        centres: list[Tensor] = []
        strides: list[Tensor] = []
        for level, x, stride in zip(self.levels, features, self.strides, strict=True):
            centre = cell_centres(x.shape[2], x.shape[3], stride, x.device)
            joined.append(_to_pixels(level(x), centre, stride))
            centres.append(centre)
            strides.append(torch.full((len(centre),), float(stride), device=x.device))
        outputs = LevelOutputs(*(torch.cat(parts, dim=1) for parts in zip(*joined, strict=True)))
        return outputs, torch.cat(centres), torch.cat(strides)


def cell_centres(height: int, width: int, stride: int, device: torch.device) -> Tensor:
    """(height width, 2) pixel of each cell's centre, (i + 0.5) stride - 0.5: pixel centres are integers."""
    x = (torch.arange(width, device=device) + 0.5) * stride - 0.5
    y = (torch.arange(height, device=device) + 0.5) * stride - 0.5
    return torch.stack((x.repeat(height), y.repeat_interleave(width)), dim=1)


def _to_pixels(raw: LevelOutputs, centres: Tensor, stride: int) -> LevelOutputs:
    middle = raw.boxes[..., :2].float() * stride + centres
    half = raw.boxes[..., 2:].float().clamp(max=_LONGEST).exp() * (stride / 2)
    proxy = raw.proxy.float().unflatten(2, (-1, 2)) * stride + centres[:, None]
    return raw._replace(boxes=torch.cat((middle - half, middle + half), dim=2), proxy=proxy)


def _cells_last(x: Tensor) -> Tensor:
    """(B, C, h, w) to (B, h w, C)."""
    return x.flatten(2).transpose(1, 2)
