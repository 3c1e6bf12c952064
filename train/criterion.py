"""All losses of a batch, from assignment to weighted sum."""

from __future__ import annotations

import torch
import torch.distributed as dist
from torch import Tensor

from models.dcc import DccOutputs, instance_size
from models.detector import Detector, RawOutputs
from train.assigner import assign, box_iou, keypoint_similarity
from train.config import StageConfig, TrainConfig
from train.loader import Batch
from train.losses import (
    box_loss,
    class_loss,
    in_range,
    likelihood_loss,
    proxy_loss,
    ray_loss,
    visibility_loss,
)

_TRUSTED_IOU = 0.5
"""Predicted boxes worse than this give the classifier no sensible bins; the true box stands in for them."""


def criterion(
    detector: Detector, raw: RawOutputs, batch: Batch, config: TrainConfig, stage: StageConfig
) -> dict[str, Tensor]:
    """Unweighted losses by the names in LossWeights, each a mean over the positive cells of all processes."""
    matched = assign(raw, batch, stage.oks_sigma, config.least_positives)
    image, cell = torch.nonzero(matched >= 0, as_tuple=True)
    instance = matched[image, cell]
    mean = _shared_mean(len(image), raw.boxes.device)

    boxes, true_boxes = raw.boxes[image, cell], batch.boxes[image, instance]
    keypoints, size = batch.keypoints[image, instance], instance_size(true_boxes)
    dcc = _classify(detector, raw, image, cell, boxes.detach(), true_boxes, config)
    proxy = raw.proxy[image, cell]
    target, counted = _proxy_target(dcc, proxy, keypoints, stage)
    judged = proxy if stage.proxy_target == "truth" else dcc.keypoints
    similarity = keypoint_similarity(judged.detach(), keypoints, size, stage.oks_sigma).mean(dim=1)
    classes = torch.zeros_like(raw.class_logits, dtype=torch.float32)
    classes[image, cell, batch.classes[image, instance]] = similarity.pow(stage.score_power).clamp(min=1e-3)

    losses = {
        "box": mean(box_loss(boxes, true_boxes)),
        "likelihood": mean(likelihood_loss(dcc, keypoints, size)),
        "proxy": mean(proxy_loss(proxy, target, size, counted, stage.oks_sigma)),
        "classes": mean(class_loss(raw.class_logits.float(), classes, _class_weight(raw, batch, classes))),
        "visibility": mean(visibility_loss(raw.visibility_logits[image, cell].float(), batch.visible[image, instance])),
    }
    if stage.weights.rays:
        points = batch.points[image, instance]
        seen = in_range(dcc, keypoints) * (points[..., 2] > 0)
        cameras, diameters = batch.cameras[image, instance], batch.diameters[image, instance]
        losses["rays"] = mean(ray_loss(dcc.keypoints, cameras, points, diameters, seen))
    return losses


def total(losses: dict[str, Tensor], stage: StageConfig) -> Tensor:
    """The weighted sum."""
    return torch.stack([getattr(stage.weights, name) * loss for name, loss in losses.items()]).sum()


def _classify(
    detector: Detector,
    raw: RawOutputs,
    image: Tensor,
    cell: Tensor,
    boxes: Tensor,
    true_boxes: Tensor,
    config: TrainConfig,
) -> DccOutputs:
    """Reads the positive cells, from features on in fp32; no gradient reaches the boxes through the bins."""
    trusted = box_iou(boxes, true_boxes)[:, None] > _TRUSTED_IOU
    chosen = torch.where(trusted, boxes, true_boxes)
    vectors = raw.pose_vectors[image, cell]
    with torch.autocast(boxes.device.type, torch.bfloat16, enabled=config.precision == "bf16"):
        features = detector.classifier.features(vectors)
    return detector.classifier(vectors.float(), chosen, raw.centres[cell], features.float())


def _proxy_target(dcc: DccOutputs, proxy: Tensor, keypoints: Tensor, stage: StageConfig) -> tuple[Tensor, Tensor]:
    """What the proxy follows, and for which keypoints: the truth, or the classifier where it is the closer one."""
    if stage.proxy_target == "truth":
        return keypoints, torch.ones_like(keypoints[..., 0])
    answer = dcc.keypoints.detach()
    closer = (answer - keypoints).square().sum(dim=-1) < (proxy.detach() - keypoints).square().sum(dim=-1)
    return answer, closer.to(keypoints.dtype)


def _class_weight(raw: RawOutputs, batch: Batch, classes: Tensor) -> Tensor:
    """1, but 0 for the class of an ignored instance at cells in its box that learn nothing else of that class."""
    low = (raw.centres >= batch.boxes[:, :, None, :2]).all(dim=-1)
    high = (raw.centres <= batch.boxes[:, :, None, 2:]).all(dim=-1)
    inside = (low & high & batch.ignored[:, :, None]).float()
    onehot = torch.nn.functional.one_hot(batch.classes, classes.shape[2]).float()
    ignored = (inside.transpose(1, 2) @ onehot) > 0
    return torch.where(ignored & (classes == 0), 0.0, 1.0)


def _shared_mean(count: int, device: torch.device):
    """A mean over the positives of all processes, so that their averaged gradients are those of one process."""
    processes = dist.get_world_size() if dist.is_initialized() else 1
    positives = torch.tensor(float(count), device=device)
    if processes > 1:
        dist.all_reduce(positives)
    divisor = positives.clamp(min=1) / processes
    return lambda losses: losses.sum() / divisor
