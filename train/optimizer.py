"""AdamW or Muon, the learning rate of each step, the moving average of the weights."""

from __future__ import annotations

import copy
import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from train.config import OptimizerName, StagesConfig

_MOMENTUM = 0.95
_STEPS = 5
_QUINTIC = (3.4445, -4.7750, 2.0315)
"""Coefficients of the iteration, from Jordan's post (see `Muon`): singular values end between 0.7 and 1.2."""
_RMS = 0.2
"""Root mean square of AdamW's updates, roughly; with it both optimisers take the same learning rates (Liu et al.)."""


class Muon(torch.optim.AdamW):
    """Orthogonalised momentum for the kernels of convolutions, AdamW for all else.

    Of a kernel's Nesterov momentum only the directions are kept: its singular values are all brought close to 1, so
    that rare directions are learnt as fast as common ones. A kernel is a matrix of outputs by inputs times places; each
    group of a grouped convolution is one. Sources: Jordan et al., "Muon: An optimizer for hidden layers in neural
    networks", 2024; size of the update by Liu et al., "Muon is Scalable for LLM Training", arXiv 2502.16982, sec. 2.2.

    Args:
        groups: Parameter groups for AdamW; those with `convolutions` (number of groups of each kernel) go by momentum.
        half: Whether directions are found in bfloat16, as Jordan et al. do, which does for something so rough.
    """

    def __init__(self, groups: Sequence[dict[str, Any]], half: bool = False) -> None:
        super().__init__([{"convolutions": (), **group} for group in groups], lr=0.0, fused=True)
        self._type = torch.bfloat16 if half else torch.float32

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """One step; gradients must be there."""
        groups = self.param_groups
        try:
            self.param_groups = [group for group in groups if not group["convolutions"]]
            super().step(closure)
        finally:
            self.param_groups = groups
        for group in groups:
            if group["convolutions"]:
                self._step_kernels(group)

    def _step_kernels(self, group: dict[str, Any]) -> None:
        kernels, gradients = group["params"], [kernel.grad for kernel in group["params"]]
        for kernel in kernels:
            if "momentum" not in self.state[kernel]:
                self.state[kernel]["momentum"] = torch.zeros_like(kernel)
        momenta = [self.state[kernel]["momentum"] for kernel in kernels]
        torch._foreach_lerp_(momenta, gradients, 1 - _MOMENTUM)
        ahead = torch._foreach_lerp(gradients, momenta, _MOMENTUM)
        torch._foreach_mul_(kernels, 1 - group["lr"] * group["weight_decay"])
        shapes: dict[torch.Size, list[tuple[nn.Parameter, Tensor]]] = defaultdict(list)
        for kernel, count, direction in zip(kernels, group["convolutions"], ahead, strict=True):
            matrices = direction.reshape(count, kernel.shape[0] // count, -1)
            shapes[matrices.shape[1:]].append((kernel, matrices))
        for (rows, columns), pairs in shapes.items():
            updates = orthogonalized(torch.cat([matrices for _, matrices in pairs]).to(self._type)).float()
            size = _RMS * math.sqrt(max(rows, columns))
            for (kernel, _), update in zip(pairs, updates.split([len(m) for _, m in pairs]), strict=True):
                kernel.sub_(update.reshape(kernel.shape), alpha=group["lr"] * size)


def orthogonalized(matrices: Tensor) -> Tensor:
    """The nearest matrices with orthonormal rows or columns, roughly: their singular values lie between 0.7 and 1.2.

    Args:
        matrices: (B, M, N), in whose precision it is computed.
    """
    tall = matrices.shape[-2] > matrices.shape[-1]
    x = matrices.mT if tall else matrices
    x = x / x.norm(dim=(-2, -1), keepdim=True).clamp(min=1e-30)
    a, b, c = _QUINTIC
    for _ in range(_STEPS):
        gram = x @ x.mT
        x = torch.baddbmm(x, torch.baddbmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
    return x.mT if tall else x


def build_optimizer(
    model: nn.Module, name: OptimizerName, weight_decay: float, half: bool = False
) -> torch.optim.Optimizer:
    """AdamW, or Muon, whose decay leaves alone all that is no matrix or kernel.

    Muon takes the kernels that a normalisation follows, which have no bias, but for those within single channels, which
    are no matrices. `half`: see Muon.
    """
    convolutions = [m for m in model.modules() if name == "muon" and isinstance(m, nn.Conv2d) and m.bias is None]
    kernels = {m.weight: m.groups for m in convolutions if m.groups < m.out_channels}
    others = [p for p in model.parameters() if p not in kernels]
    groups: list[dict[str, Any]] = [
        {"params": [p for p in others if p.ndim > 1], "weight_decay": weight_decay},
        {"params": [p for p in others if p.ndim <= 1], "weight_decay": 0.0},
    ]
    if name == "adamw":
        return torch.optim.AdamW(groups, lr=0.0, fused=True)
    orthogonal = {"params": list(kernels), "weight_decay": weight_decay, "convolutions": tuple(kernels.values())}
    return Muon([*groups, orthogonal], half)


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
