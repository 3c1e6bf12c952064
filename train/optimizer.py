"""AdamW without decay on biases and norms, the learning rate of each step, the moving average of the weights."""

from __future__ import annotations

import copy
import math

import torch
from torch import nn

from train.config import StagesConfig


def build_optimizer(model: nn.Module, weight_decay: float) -> torch.optim.AdamW:
    """AdamW whose decay leaves alone all that is not a matrix or a kernel."""
    matrices = [p for p in model.parameters() if p.ndim > 1]
    vectors = [p for p in model.parameters() if p.ndim <= 1]
    groups = [{"params": matrices, "weight_decay": weight_decay}, {"params": vectors, "weight_decay": 0.0}]
    return torch.optim.AdamW(groups, lr=0.0, fused=True)


def learning_rate(stages: StagesConfig, steps_per_epoch: int, warmup_steps: int, step: int) -> float:
    """Of a step of the run: a cosine from start to end within each stage, times a quadratic warm-up of the run."""
    epoch = min(step // steps_per_epoch, stages.epochs - 1)
    stage, first = stages.at(epoch)
    fraction = (step - first * steps_per_epoch) / max(stage.epochs * steps_per_epoch - 1, 1)
    cosine = (1 + math.cos(math.pi * min(fraction, 1.0))) / 2
    rate = stage.learning_rate_end + (stage.learning_rate_start - stage.learning_rate_end) * cosine
    return rate * min(1.0, (step + 1) / max(warmup_steps, 1)) ** 2


class MovingAverage:
    """Exponential moving average of a model's weights and buffers; young averages forget faster.

    The model's tensors must stay where they are; their values may be loaded anew.
    """

    def __init__(self, model: nn.Module, decay: float) -> None:
        self.model = copy.deepcopy(model).eval().requires_grad_(False)
        self.decay, self.updates = decay, 0
        # Looked up once: to walk through all modules takes longer than to average them.
        pairs = list(zip(self.model.state_dict().values(), model.state_dict().values(), strict=True))
        self._kept, self._new = zip(*(pair for pair in pairs if pair[0].is_floating_point()), strict=True)
        self._counts = [pair for pair in pairs if not pair[0].is_floating_point()]

    @torch.no_grad()
    def update(self) -> None:
        """Moves the average towards the model by 1 - min(decay, (1 + n) / (10 + n)) at the n-th update."""
        self.updates += 1
        decay = min(self.decay, (1 + self.updates) / (10 + self.updates))
        torch._foreach_lerp_(self._kept, self._new, 1 - decay)
        for count, latest in self._counts:
            count.copy_(latest)
