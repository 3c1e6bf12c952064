"""SimOTA with poses: which cells learn which instance (RTMO's `sim_ota_assigner`, after YOLOX and OTA)."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from models.dcc import instance_size
from models.detector import RawOutputs
from train.loader import Batch

_RADIUS = 2.5
"""Candidates lie within this many strides of the instance's centre, or in its box."""
_TOP = 10
"""The OKS of this many best cells, summed, says how many cells learn an instance; no more than this do."""
_OUTSIDE = 1e5
"""Cost of a cell that is not both in the box and near the centre: taken only when nothing else is left."""
_NOWHERE = 1e9


@torch.no_grad()
def assign(raw: RawOutputs, batch: Batch, oks_sigma: float, least_positives: int) -> Tensor:
    """Matches cells to instances.

    The cost of a pair is 3 (-ln IoU) + 3 (-ln OKS of the proxy) + the cross entropy of the class. Each instance takes
    its k cheapest candidates, k being the sum of its best OKS; a cell that several instances want goes to the cheapest.

    Returns:
        (B, A) int64: the instance each cell learns, or -1.
    """
    candidate, both = _candidates(raw, batch)
    at = torch.nonzero(candidate, as_tuple=True)
    image, instance, cell = at
    iou = box_iou(batch.boxes[image, instance], raw.boxes[image, cell])
    size = instance_size(batch.boxes)[image, instance]
    similarity = keypoint_similarity(raw.proxy[image, cell], batch.keypoints[image, instance], size, oks_sigma)
    oks = torch.zeros_like(candidate, dtype=torch.float32)
    oks[at] = similarity.mean(dim=-1)
    cost = torch.full_like(oks, _NOWHERE)
    by_shape = 3 * -(iou + 1e-7).log() + 3 * -(oks[at] + 1e-7).log()
    cost[at] = by_shape + _class_cost(raw.class_logits, batch.classes)[at] + _OUTSIDE * ~both[at]

    top = min(_TOP, cost.shape[2])
    wanted = oks.topk(top, dim=2).values.sum(dim=2).int().clamp(min=least_positives, max=top)
    cheapest = cost.topk(top, dim=2, largest=False)
    taken = (torch.arange(top, device=cost.device) < wanted[..., None]) & (cheapest.values < _NOWHERE)
    chosen = torch.zeros_like(candidate).scatter(2, cheapest.indices, taken)
    contest = torch.where(chosen, cost, _NOWHERE)
    return torch.where(chosen.any(dim=1), contest.argmin(dim=1), -1)


def box_iou(a: Tensor, b: Tensor) -> Tensor:
    """Intersection over union of boxes (..., 4) and (..., 4), broadcast."""
    low, high = torch.maximum(a[..., :2], b[..., :2]), torch.minimum(a[..., 2:], b[..., 2:])
    common = (high - low).clamp(min=0).prod(dim=-1)
    area_a = (a[..., 2:] - a[..., :2]).clamp(min=0).prod(dim=-1)
    area_b = (b[..., 2:] - b[..., :2]).clamp(min=0).prod(dim=-1)
    return common / (area_a + area_b - common).clamp(min=1e-6)


def keypoint_similarity(predicted: Tensor, target: Tensor, size: Tensor, sigma: float) -> Tensor:
    """OKS of each keypoint (..., K): exp(-d^2 / (2 (2 sigma size)^2)); size (...) in pixels."""
    distance = (predicted - target).square().sum(dim=-1)
    return torch.exp(-distance / (8 * sigma**2 * size.square().clamp(min=1)[..., None]))


def _candidates(raw: RawOutputs, batch: Batch) -> tuple[Tensor, Tensor]:
    """Whether a cell may learn an instance, and whether it is both in its box and near its centre; (B, G, A)."""
    offset_low = raw.centres - batch.boxes[:, :, None, :2]
    offset_high = batch.boxes[:, :, None, 2:] - raw.centres
    in_box = torch.minimum(offset_low, offset_high).amin(dim=-1) > 0
    centre = batch.keypoints.mean(dim=2)[:, :, None]
    near = (raw.centres - centre).abs().amax(dim=-1) < _RADIUS * raw.strides
    learnt = batch.learnt[:, :, None]
    return (in_box | near) & learnt, in_box & near & learnt


def _class_cost(logits: Tensor, classes: Tensor) -> Tensor:
    """(B, G, A) cross entropy of the square roots of the probabilities (B, A, C) with each instance's class."""
    root = 0.5 * F.logsigmoid(logits.float())
    # log(1 - sqrt p), kept finite where p is almost 1.
    rest = torch.log1p(-root.exp().clamp(max=1 - 1e-6))
    own = (rest - root).transpose(1, 2)
    index = classes[:, :, None].expand(-1, -1, own.shape[2])
    return own.gather(1, index) - rest.sum(dim=2)[:, None]
