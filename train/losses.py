"""The six losses, each a function of tensors; P rows are the positive cells, each with its instance's labels."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from models.dcc import DccOutputs
from train.assigner import box_iou, keypoint_similarity


def box_loss(predicted: Tensor, target: Tensor) -> Tensor:
    """1 - IoU^2 of boxes (P, 4); (P,)."""
    return 1 - box_iou(predicted, target).square()


def likelihood_loss(dcc: DccOutputs, target: Tensor, size: Tensor) -> Tensor:
    """-ln(P_x P_y + 1e-4) with P = sum over bins of p exp(-|target - bin| / (2 sigma size)) / sigma; (P,).

    Maximum likelihood of the keypoints under the heat maps with a Laplace density of learnt scale (RTMO). Keypoints
    outside the range of the bins cannot be learnt and do not count.

    Args:
        target: (P, K, 2) pixels.
        size: (P,) size of the instance, pixels.
    """
    sigma = dcc.sigma.clamp(min=1e-3)
    scale = 2 * sigma * size.clamp(min=1)[:, None]
    density_x = _density(dcc.heat_x, dcc.bins_x, target[..., 0], sigma, scale)
    density_y = _density(dcc.heat_y, dcc.bins_y, target[..., 1], sigma, scale)
    loss = -(density_x * density_y + 1e-4).log()
    inside = in_range(dcc, target)
    return (loss * inside).sum(dim=1) / target.shape[1]


def proxy_loss(proxy: Tensor, target: Tensor, size: Tensor, counted: Tensor, sigma: float) -> Tensor:
    """1 - OKS of the regressed keypoints, plus their distance in units of the instance's size; (P,).

    OKS alone is flat a few sigma away from the target, where a new network starts; the distance pulls it in.

    Args:
        proxy, target: (P, K, 2) pixels.
        size: (P,) pixels.
        counted: (P, K) 0 or 1.
    """
    similarity = keypoint_similarity(proxy, target, size, sigma)
    distance = (proxy - target).abs().sum(dim=2) / size.clamp(min=1)[:, None]
    return ((1 - similarity + distance) * counted).sum(dim=1) / counted.shape[1]


def class_loss(logits: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Varifocal loss, summed: BCE times 0.75 p^2 where the target is 0, times the target elsewhere.

    Args:
        logits, target: (B, A, C); weight: (B, A, C), 0 where nothing is to be learnt.
    """
    focus = torch.where(target > 0, target, 0.75 * logits.detach().sigmoid().square())
    return (F.binary_cross_entropy_with_logits(logits, target, reduction="none") * focus * weight).sum()


def visibility_loss(logits: Tensor, visible: Tensor) -> Tensor:
    """Binary cross entropy of (P, K) logits with 0 or 1; (P,)."""
    return F.binary_cross_entropy_with_logits(logits, visible, reduction="none").mean(dim=1)


def ray_loss(pixels: Tensor, cameras: Tensor, points: Tensor, diameters: Tensor, counted: Tensor) -> Tensor:
    """Smooth L1 of the vector from each true 3-D keypoint to its foot on the predicted pixel's ray; (P,).

    e = (b b' / b'b X - X) / diameter with b = K'^-1 (u, v, 1), then SmoothL1(50 e) / 50, the mean over 3 K coordinates
    (Hu et al. 2021, "Wide-depth-range 6D object pose estimation in space"). K' = M K of an affinely warped picture
    leaves it unchanged, for ray and point stay where they were.

    Args:
        pixels: (P, K, 2); cameras: (P, 3, 3); points: (P, K, 3) metres; diameters: (P,) metres.
        counted: (P, K) 0 or 1.
    """
    homogeneous = F.pad(pixels, (0, 1), value=1.0)
    rays = F.normalize(homogeneous @ torch.linalg.inv(cameras).transpose(1, 2), dim=2)
    foot = (points * rays).sum(dim=2, keepdim=True) * rays
    error = (foot - points) / diameters[:, None, None]
    loss = F.smooth_l1_loss(50 * error, torch.zeros_like(error), reduction="none") / 50
    return (loss.mean(dim=2) * counted).sum(dim=1) / counted.shape[1]


def in_range(dcc: DccOutputs, target: Tensor) -> Tensor:
    """(P, K) 0 or 1: whether the bins reach the target (P, K, 2)."""
    x, y = target[..., 0], target[..., 1]
    within_x = (x >= dcc.bins_x[:, :1]) & (x <= dcc.bins_x[:, -1:])
    within_y = (y >= dcc.bins_y[:, :1]) & (y <= dcc.bins_y[:, -1:])
    return (within_x & within_y).to(target.dtype)


def _density(heat: Tensor, bins: Tensor, target: Tensor, sigma: Tensor, scale: Tensor) -> Tensor:
    """Expectation over the heat map of exp(-|target - bin| / scale) / sigma; (P, K)."""
    distance = (target[..., None] - bins[:, None]).abs()
    return (heat * torch.exp(distance * (-1 / scale)[..., None])).sum(dim=2) / sigma
