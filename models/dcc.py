"""Dynamic coordinate classifier of RTMO (Lu et al. 2023): a pose vector to a heat map per keypoint and axis.

The bins lie on the predicted box, enlarged by a quarter, so every instance is read at a resolution that suits its size.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

ENLARGEMENT = 1.25
"""Side of the range of bins over the side of the box."""

_FEATURES = 128
"""Channels of a keypoint's feature and of a bin's encoding."""

_TEMPERATURE = 300.0
"""Longest wavelength of the bin encoding over 2 pi, pixels."""

_LEAST_STD = 0.5
"""Pixels; no keypoint is trusted beyond this."""


class DccOutputs(NamedTuple):
    """Keypoints of M instances; pixels of the network's input.

    Attributes:
        keypoints: (M, K, 2) expectation of the heat maps.
        heat_x, heat_y: (M, K, bins) probability of each bin.
        bins_x, bins_y: (M, bins) position of each bin.
        sigma: (M, K) learned scale, relative to twice the size of the instance.
        size: (M,) of the instances as their boxes say, pixels.
    """

    keypoints: Tensor
    heat_x: Tensor
    heat_y: Tensor
    bins_x: Tensor
    bins_y: Tensor
    sigma: Tensor
    size: Tensor

    @property
    def variance(self) -> Tensor:
        """(M, K, 2) of the heat maps, square pixels."""
        mean_x, mean_y = self.keypoints.unbind(dim=-1)
        along_x = _mean(self.heat_x, (self.bins_x[:, None] - mean_x[..., None]).square())
        along_y = _mean(self.heat_y, (self.bins_y[:, None] - mean_y[..., None]).square())
        return torch.stack((along_x, along_y), dim=-1)

    @property
    def std(self) -> Tensor:
        """(M, K, 2) standard deviation that joins both: the larger of heat map and learned scale, at least 0.5."""
        # The likelihood is a Laplace density of scale 2 sigma size, whose deviation is sqrt(2) times that.
        learned = 2 * math.sqrt(2) * self.sigma * self.size[:, None]
        return torch.maximum(self.variance, learned[..., None] ** 2).clamp(min=_LEAST_STD**2).sqrt()


class DynamicCoordinateClassifier(nn.Module):
    """Keypoint features and bin encodings, multiplied into logits."""

    def __init__(self, pose_vector: int, num_keypoints: int, bins: int) -> None:
        super().__init__()
        self.num_keypoints, self.bins = num_keypoints, bins
        self.to_features = nn.Linear(pose_vector, num_keypoints * _FEATURES, bias=False)
        self.norm: nn.Module = RowNorm(num_keypoints * _FEATURES)
        self.mix = GatedAttentionUnit(num_keypoints, _FEATURES)
        self.encode_x = nn.Linear(_FEATURES, _FEATURES)
        self.encode_y = nn.Linear(_FEATURES, _FEATURES)
        self.to_sigma = nn.Linear(pose_vector, num_keypoints)
        self.sigma_scale = nn.Parameter(torch.tensor(0.1))
        frequency = _TEMPERATURE ** -(torch.arange(_FEATURES // 2) / (_FEATURES // 2))
        self.register_buffer("frequency", frequency, persistent=False)
        self.register_buffer("steps", torch.linspace(-0.5, 0.5, bins), persistent=False)

    def forward(
        self, pose_vectors: Tensor, boxes: Tensor, centres: Tensor, features: Tensor | None = None
    ) -> DccOutputs:
        """Reads the keypoints of M instances.

        Args:
            pose_vectors: (M, D) of the cells that hold the instances.
            boxes: (M, 4) x0 y0 x1 y1 pixels.
            centres: (M, 2) pixel centres of the cells.
            features: of the pose vectors, where they have been computed before, in half precision.
        """
        return self.read(self.features(pose_vectors) if features is None else features, pose_vectors, boxes, centres)

    def features(self, pose_vectors: Tensor) -> Tensor:
        """(M, K, C) of the keypoints; half precision does for this part."""
        features = self.norm(self.to_features(pose_vectors))
        return self.mix(features.unflatten(1, (self.num_keypoints, _FEATURES)))

    def read(self, features: Tensor, pose_vectors: Tensor, boxes: Tensor, centres: Tensor) -> DccOutputs:
        """Compares features with bins; in full precision, for logits are differences of large numbers."""
        middle = (boxes[:, :2] + boxes[:, 2:]) / 2
        size = (boxes[:, 2:] - boxes[:, :2]) * ENLARGEMENT
        bins = middle[:, None] + self.steps[:, None] * size[:, None]
        offset = middle - centres
        heat_x = self._logits(features, self.encode_x, offset[:, 0], size[:, 0]).softmax(dim=2)
        heat_y = self._logits(features, self.encode_y, offset[:, 1], size[:, 1]).softmax(dim=2)
        keypoints = torch.stack((_mean(heat_x, bins[:, None, :, 0]), _mean(heat_y, bins[:, None, :, 1])), dim=-1)
        sigma = torch.sigmoid(self.to_sigma(pose_vectors)) * self.sigma_scale
        return DccOutputs(keypoints, heat_x, heat_y, bins[..., 0], bins[..., 1], sigma, instance_size(boxes))

    def _logits(self, features: Tensor, encode: nn.Linear, offset: Tensor, size: Tensor) -> Tensor:
        """Feature times linearly mapped sine encoding of the bins at offset + steps * size (M,); (M, K, bins).

        The map is applied to the few features, transposed, and not to the many bins, and so is the turn of the phases
        by the offset: the product is the same. What is left depends on steps * size, which is as much to the left as to
        the right, so that the even and the odd part of one half give both.
        """
        turn = (offset[:, None] * self.frequency)[:, None]
        cosine, sine = (features @ encode.weight).chunk(2, dim=2)
        even = cosine * turn.cos() + sine * turn.sin()
        odd = sine * turn.cos() - cosine * turn.sin()
        half = self.bins // 2
        angles = self.frequency[:, None] * (self.steps[half:] * size[:, None])[:, None]
        even, odd = even @ angles.cos(), odd @ angles.sin()
        left = (even - odd)[..., self.bins % 2 :].flip(2)
        return torch.cat((left, even + odd), dim=2) + (features * encode.bias).sum(dim=2, keepdim=True)


class RowNorm(nn.BatchNorm1d):
    """Batch normalisation that falls back on its running statistics where a batch has too few rows for its own."""

    def forward(self, input: Tensor) -> Tensor:
        """(M, C), same shape; M may be 0 or 1."""
        if self.training and len(input) < 2:
            return F.batch_norm(input, self.running_mean, self.running_var, self.weight, self.bias, eps=self.eps)
        return super().forward(input)


class GatedAttentionUnit(nn.Module):
    """Lets the keypoints of an instance see each other (Hua et al. 2022, arXiv 2202.10447)."""

    def __init__(self, tokens: int, channels: int, expansion: int = 256, key: int = 128) -> None:
        super().__init__()
        self.sizes = (expansion, expansion, key)
        self.scale = nn.Parameter(torch.ones(1))
        self.to_parts = nn.Linear(channels, sum(self.sizes), bias=False)
        # Small numbers, as in the paper: the unit starts as the identity. With RTMO's uniform ones the tokens
        # start drowned in their common mean, and a small network does not recover from that.
        self.gamma = nn.Parameter(0.02 * torch.randn(2, key))
        self.beta = nn.Parameter(torch.zeros(2, key))
        self.place = nn.Parameter(0.02 * torch.randn(tokens, key))
        self.out = nn.Linear(expansion, channels, bias=False)
        self.residual = nn.Parameter(torch.ones(channels))

    def forward(self, x: Tensor) -> Tensor:
        """(M, K, C), same shape."""
        rms = x.norm(dim=2, keepdim=True) * x.shape[2] ** -0.5
        normal = x / rms.clamp(min=1e-5) * self.scale
        gate, value, base = F.silu(self.to_parts(normal)).split(self.sizes, dim=2)
        query = base * self.gamma[0] + self.beta[0] + self.place
        key = base * self.gamma[1] + self.beta[1] + self.place
        kernel = F.relu(query @ key.transpose(1, 2) / math.sqrt(self.sizes[2])).square()
        return x * self.residual + self.out(gate * (kernel @ value))


def instance_size(boxes: Tensor) -> Tensor:
    """Square root of an instance's area, pixels, from boxes (..., 4); the unit in which errors are judged.

    COCO takes 0.53 w h where no silhouette is known. That is the same for square boxes, but almost nothing for a
    long part that lies along an axis; half the sum of squares in place of the product does not change with roll.
    """
    return (0.53 / 2 * (boxes[..., 2:] - boxes[..., :2]).square().sum(dim=-1)).sqrt()


def _mean(heat: Tensor, values: Tensor) -> Tensor:
    """(M, K) of values (M, 1 or K, bins) over the heat maps (M, K, bins)."""
    return (heat * values).sum(dim=2)
