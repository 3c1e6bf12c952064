"""The parts assembled: images to raw outputs per cell, chosen cells to keypoints."""

from __future__ import annotations

import copy
from typing import NamedTuple

from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_linear_bn_eval

from models.backbone import CspDarknet
from models.blocks import ConvBlock, RepBlock
from models.config import ModelConfig
from models.dcc import DccOutputs, DynamicCoordinateClassifier
from models.head import Head
from models.neck import build_neck

OFFSET, SCALE = 114.0, 64.0
"""Of the pixels: grey is 0 and the range is about one, so that the first layer starts well scaled."""


class RawOutputs(NamedTuple):
    """Outputs of all A cells of all levels; pixels of the network's input.

    Attributes:
        class_logits: (B, A, C).
        boxes: (B, A, 4) amodal x0 y0 x1 y1.
        proxy: (B, A, K, 2) regressed keypoints that guide training.
        visibility_logits: (B, A, K).
        pose_vectors: (B, A, D) input of the coordinate classifier.
        centres: (A, 2) pixel centre of each cell.
        strides: (A,).
    """

    class_logits: Tensor
    boxes: Tensor
    proxy: Tensor
    visibility_logits: Tensor
    pose_vectors: Tensor
    centres: Tensor
    strides: Tensor


class Decoded(NamedTuple):
    """The N best cells of each image, best first; pixels of the network's input.

    Attributes:
        boxes: (B, N, 4); scores: (B, N) probabilities; labels: (B, N) class indices.
        keypoints: (B, N, K, 2); visibility: (B, N, K) probabilities; std: (B, N, K, 2).
    """

    boxes: Tensor
    scores: Tensor
    labels: Tensor
    keypoints: Tensor
    visibility: Tensor
    std: Tensor


class Detector(nn.Module):
    """Backbone, neck, head and coordinate classifier."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.backbone = CspDarknet(config)
        self.neck = build_neck(config)
        self.head = Head(config)
        self.classifier = DynamicCoordinateClassifier(config.pose_vector, config.num_keypoints, config.bins)

    def forward(self, images: Tensor) -> RawOutputs:
        """Images (B, 3, H, W) float RGB 0..255, H and W multiples of 32, to the outputs of every cell."""
        features = self.neck(self.backbone((images - OFFSET) / SCALE))
        outputs, centres, strides = self.head(features)
        return RawOutputs(*outputs, centres, strides)

    def dcc(self, pose_vectors: Tensor, boxes: Tensor, centres: Tensor) -> DccOutputs:
        """Keypoints of M cells from pose vectors (M, D), boxes (M, 4) and cell centres (M, 2)."""
        return self.classifier(pose_vectors, boxes, centres)

    def decode(self, raw: RawOutputs, count: int) -> Decoded:
        """The `count` best cells of each image with their keypoints; shapes do not depend on the data."""
        score, label = raw.class_logits.max(dim=2)
        score, cell = score.topk(count, dim=1)

        def pick(values: Tensor) -> Tensor:
            index = cell.reshape(*cell.shape, *(1,) * (values.dim() - 2))
            return values.gather(1, index.expand(-1, -1, *values.shape[2:]))

        boxes, vectors = pick(raw.boxes), pick(raw.pose_vectors)
        dcc = self.dcc(vectors.flatten(0, 1), boxes.flatten(0, 1), raw.centres[cell].flatten(0, 1))
        per_image = (-1, count, self.config.num_keypoints, 2)
        return Decoded(
            boxes,
            score.sigmoid(),
            label.gather(1, cell),
            dcc.keypoints.reshape(per_image),
            pick(raw.visibility_logits).sigmoid(),
            dcc.std.reshape(per_image),
        )

    def fuse(self) -> Detector:
        """A copy for deployment, in evaluation mode: normalisations folded, re-parameterised blocks merged."""
        fused = copy.deepcopy(self).eval()
        for module in fused.modules():
            if isinstance(module, RepBlock):
                module.fold()
        for module in fused.modules():
            if isinstance(module, ConvBlock):
                module.fold()
        classifier = fused.classifier
        if isinstance(classifier.norm, nn.BatchNorm1d):
            classifier.to_features = fuse_linear_bn_eval(classifier.to_features, classifier.norm)
            classifier.norm = nn.Identity()
        return fused.requires_grad_(False)


def count_parameters(module: nn.Module) -> int:
    """Number of trained scalars."""
    return sum(p.numel() for p in module.parameters())
