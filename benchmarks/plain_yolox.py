"""YOLOX (Ge et al. 2021, arXiv 2107.08430) written plainly in torch, to be measured against; not part of the product.

Space-to-depth stem, CSPDarknet, PAFPN, decoupled head with objectness, SimOTA image by image, IoU loss and binary cross
entropies. Convolutions are plain at every size, as ours are (YOLOX's own nano has depthwise ones).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.config import ModelConfig
from train.loader import Batch

STRIDES = (8, 16, 32)
_RADIUS = 1.5
_TOP = 10


def conv(inputs: int, outputs: int, kernel: int, stride: int = 1) -> nn.Sequential:
    """Convolution, batch normalisation, SiLU."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(outputs, 1e-3, 0.03),
        nn.SiLU(inplace=True),
    )


class Bottleneck(nn.Module):
    def __init__(self, channels: int, shortcut: bool) -> None:
        super().__init__()
        self.layers, self.shortcut = nn.Sequential(conv(channels, channels, 1), conv(channels, channels, 3)), shortcut

    def forward(self, x: Tensor) -> Tensor:
        return x + self.layers(x) if self.shortcut else self.layers(x)


class Csp(nn.Module):
    def __init__(self, inputs: int, outputs: int, repeats: int, shortcut: bool = True) -> None:
        super().__init__()
        half = outputs // 2
        self.main, self.side, self.merge = conv(inputs, half, 1), conv(inputs, half, 1), conv(2 * half, outputs, 1)
        self.blocks = nn.Sequential(*(Bottleneck(half, shortcut) for _ in range(repeats)))

    def forward(self, x: Tensor) -> Tensor:
        return self.merge(torch.cat((self.blocks(self.main(x)), self.side(x)), 1))


class Spp(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.reduce, self.merge = conv(channels, channels // 2, 1), conv(2 * channels, channels, 1)
        self.pools = nn.ModuleList(nn.MaxPool2d(k, 1, k // 2) for k in (5, 9, 13))

    def forward(self, x: Tensor) -> Tensor:
        x = self.reduce(x)
        return self.merge(torch.cat([x, *(pool(x) for pool in self.pools)], 1))


class HeadLevel(nn.Module):
    """One stride: a stem, then two branches of two convolutions."""

    def __init__(self, inputs: int, hidden: int, classes: int) -> None:
        super().__init__()
        self.stem = conv(inputs, hidden, 1)
        self.for_classes = nn.Sequential(conv(hidden, hidden, 3), conv(hidden, hidden, 3))
        self.for_boxes = nn.Sequential(conv(hidden, hidden, 3), conv(hidden, hidden, 3))
        self.classes, self.boxes = nn.Conv2d(hidden, classes, 1), nn.Conv2d(hidden, 5, 1)
        nn.init.constant_(self.classes.bias, -4.6)  # pyright: ignore[reportArgumentType]

    def forward(self, x: Tensor) -> Tensor:
        x = self.stem(x)
        out = torch.cat((self.boxes(self.for_boxes(x)), self.classes(self.for_classes(x))), 1)
        return out.flatten(2).transpose(1, 2)


class PlainYolox(nn.Module):
    """Images (B, 3, H, W) to losses."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        c2, (c3, c4, c5) = round(128 * config.width), config.channels
        stem = round(64 * config.width)
        n3, n9 = config.repeats(3), config.repeats(9)
        self.stem = conv(12, stem, 3)
        self.dark2 = nn.Sequential(conv(stem, c2, 3, 2), Csp(c2, c2, n3))
        self.dark3 = nn.Sequential(conv(c2, c3, 3, 2), Csp(c3, c3, n9))
        self.dark4 = nn.Sequential(conv(c3, c4, 3, 2), Csp(c4, c4, n9))
        self.dark5 = nn.Sequential(conv(c4, c5, 3, 2), Spp(c5), Csp(c5, c5, n3, False))
        self.lateral5, self.lateral4 = conv(c5, c4, 1), conv(c4, c3, 1)
        self.down4, self.down3 = Csp(2 * c4, c4, n3, False), Csp(2 * c3, c3, n3, False)
        self.reduce3, self.reduce4 = conv(c3, c3, 3, 2), conv(c4, c4, 3, 2)
        self.up4, self.up5 = Csp(2 * c3, c4, n3, False), Csp(2 * c4, c5, n3, False)
        hidden = round(256 * config.width)
        self.head = nn.ModuleList(HeadLevel(c, hidden, config.num_classes) for c in (c3, c4, c5))

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Outputs (B, A, 5 + C) still relative to cells, centres (A, 2) and strides (A,)."""
        x = self.dark2(self.stem(F.pixel_unshuffle(images, 2)))
        at8 = self.dark3(x)
        at16 = self.dark4(at8)
        top = self.lateral5(self.dark5(at16))
        mid = self.lateral4(self.down4(torch.cat((F.interpolate(top, scale_factor=2), at16), 1)))
        out8 = self.down3(torch.cat((F.interpolate(mid, scale_factor=2), at8), 1))
        out16 = self.up4(torch.cat((self.reduce3(out8), mid), 1))
        out32 = self.up5(torch.cat((self.reduce4(out16), top), 1))
        outputs, centres, strides = [], [], []
        for level, features, stride in zip(self.head, (out8, out16, out32), STRIDES, strict=True):
            height, width = features.shape[2:]
            y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
            outputs.append(level(features))
            centres.append((torch.stack((x, y), 2).flatten(0, 1).to(images.device) + 0.5) * stride)
            strides.append(torch.full((height * width,), float(stride), device=images.device))
        return torch.cat(outputs, 1), torch.cat(centres), torch.cat(strides)


def loss(outputs: Tensor, centres: Tensor, strides: Tensor, batch: Batch) -> Tensor:
    """5 IoU loss + objectness + classes, over the positives of the batch."""
    outputs = outputs.float()
    middle = outputs[..., :2] * strides[:, None] + centres
    size = outputs[..., 2:4].clamp(max=6).exp() * strides[:, None]
    boxes = torch.cat((middle - size / 2, middle + size / 2), 2)
    objectness, classes = outputs[..., 4], outputs[..., 5:]
    wanted = torch.zeros_like(objectness)
    chosen, targets, onehots = [], [], []
    for i in range(len(outputs)):
        truth, label = batch.boxes[i][batch.learnt[i]], batch.classes[i][batch.learnt[i]]
        if not len(truth):
            continue
        cells, instance, overlap = assign(boxes[i], objectness[i], classes[i], centres, strides, truth, label)
        wanted[i, cells] = 1
        chosen.append((torch.full_like(cells, i), cells))
        targets.append(truth[instance])
        onehots.append(F.one_hot(label[instance], classes.shape[2]) * overlap[:, None])
    image, cell = (torch.cat(parts) for parts in zip(*chosen, strict=True))
    count = max(len(image), 1)
    for_boxes = (1 - pair_iou(boxes[image, cell], torch.cat(targets)).square()).sum()
    for_objects = F.binary_cross_entropy_with_logits(objectness, wanted, reduction="sum")
    for_classes = F.binary_cross_entropy_with_logits(classes[image, cell], torch.cat(onehots), reduction="sum")
    return (5 * for_boxes + for_objects + for_classes) / count


@torch.no_grad()
def assign(
    boxes: Tensor, objectness: Tensor, classes: Tensor, centres: Tensor, strides: Tensor, truth: Tensor, label: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """SimOTA of one image: the cells that learn, the instance of each, and the overlap they have."""
    offset = torch.cat((centres - truth[:, None, :2], truth[:, None, 2:] - centres), 2)
    in_box = offset.amin(2) > 0
    near = (centres - (truth[:, None, :2] + truth[:, None, 2:]) / 2).abs().amax(2) < _RADIUS * strides
    cells = torch.nonzero((in_box | near).any(0))[:, 0]
    both = (in_box & near)[:, cells]
    overlap = pair_iou(truth[:, None], boxes[None, cells])
    score = (classes[cells].sigmoid() * objectness[cells, None].sigmoid()).sqrt()
    onehot = F.one_hot(label, classes.shape[1]).float()
    for_class = F.binary_cross_entropy(
        score.expand(len(truth), -1, -1), onehot[:, None].expand(-1, len(cells), -1), reduction="none"
    ).sum(2)
    cost = for_class - 3 * (overlap + 1e-8).log() + 1e6 * ~both
    best = overlap.topk(min(_TOP, len(cells)), 1).values.sum(1).int().clamp(min=1)
    matched = torch.zeros_like(cost, dtype=torch.bool)
    for row, k in enumerate(best.tolist()):
        matched[row, cost[row].topk(k, largest=False).indices] = True
    several = matched.sum(0) > 1
    matched[:, several] = F.one_hot(cost[:, several].argmin(0), len(truth)).bool().T
    used = matched.any(0)
    instance = matched[:, used].int().argmax(0)
    return cells[used], instance, overlap[:, used].gather(0, instance[None])[0]


def pair_iou(a: Tensor, b: Tensor) -> Tensor:
    """Intersection over union of boxes (..., 4), broadcast."""
    low, high = torch.maximum(a[..., :2], b[..., :2]), torch.minimum(a[..., 2:], b[..., 2:])
    common = (high - low).clamp(min=0).prod(-1)
    area = (a[..., 2:] - a[..., :2]).prod(-1) + (b[..., 2:] - b[..., :2]).prod(-1)
    return common / (area - common).clamp(min=1e-6)
