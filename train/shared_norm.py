"""Batch normalisation over the batch of all processes, on any device; PyTorch's own needs a GPU.

A run of P processes with B pictures each then computes what one process with P B pictures does. Without it every
process normalises by its own pictures, and the running statistics that are kept are those of the first process alone.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional as F
from torch.nn.modules.batchnorm import _BatchNorm


class SharedNorm(_BatchNorm):
    """Batch normalisation whose mean and variance are those of all processes together.

    Every process must come here equally often; one without a single row (N = 0) still takes part. With fewer than two
    rows in all, the running statistics stand in, as in models.dcc.RowNorm.
    """

    def _check_input_dim(self, input: Tensor) -> None:
        """Takes (N, C) and (N, C, H, W)."""

    def forward(self, input: Tensor) -> Tensor:
        """Same shape."""
        if not self.training:
            return super().forward(input)
        mean, variance, count = _statistics(input.detach())
        if count < 2:
            return F.batch_norm(input, self.running_mean, self.running_var, self.weight, self.bias, eps=self.eps)
        assert self.running_mean is not None and self.running_var is not None and self.num_batches_tracked is not None
        assert self.momentum is not None
        self.num_batches_tracked += 1
        self.running_mean.lerp_(mean, self.momentum)
        self.running_var.lerp_(variance * (count / (count - 1)), self.momentum)
        return _Normalise.apply(input, self.weight, self.bias, mean, variance, count, self.eps)


def share_norms(module: nn.Module) -> None:
    """Replaces every batch normalisation inside a module; parameters, buffers and their names stay."""
    for name, child in module.named_children():
        if isinstance(child, _BatchNorm) and not isinstance(child, SharedNorm):
            shared = SharedNorm(child.num_features, child.eps, child.momentum)
            shared._parameters, shared._buffers = child._parameters, child._buffers
            setattr(module, name, shared.train(child.training))
        else:
            share_norms(child)


def _statistics(x: Tensor) -> tuple[Tensor, Tensor, float]:
    """Mean and variance (C,) over the rows of all processes, and how many rows there are."""
    channels = x.shape[1]
    rows = x.numel() // channels
    exact = {"device": x.device, "dtype": torch.promote_types(x.dtype, torch.float32)}
    own = torch.zeros(2 * channels + 1, **exact)
    if rows:
        # Buffers of fp32 make it answer in fp32 where x is bf16.
        unused = torch.zeros(2, channels, **exact)
        own = torch.cat((*torch.batch_norm_update_stats(x, unused[0], unused[1], 0.0), own.new_tensor([rows])))
    everyone = [torch.empty_like(own) for _ in range(dist.get_world_size())]
    dist.all_gather(everyone, own)
    means, variances, counts = torch.stack(everyone).split((channels, channels, 1), dim=1)
    share = counts / counts.sum().clamp(min=1)
    # Variances about different means add up with the squares of the differences (Chan et al. 1979).
    mean = (share * means).sum(dim=0)
    variance = (share * (variances + (means - mean).square())).sum(dim=0)
    return mean, variance, float(counts.sum())


class _Normalise(torch.autograd.Function):
    """y = (x - mean) / sqrt(variance + eps) * weight + bias, with the gradient through the shared statistics."""

    @staticmethod
    def forward(
        ctx: Any, x: Tensor, weight: Tensor, bias: Tensor, mean: Tensor, variance: Tensor, count: float, eps: float
    ) -> Tensor:
        """The statistics are given; rows (N, C, ...)."""
        ctx.save_for_backward(x, weight, mean, variance)
        ctx.count, ctx.eps = count, eps
        if not len(x):
            return torch.empty_like(x)
        return F.batch_norm(x, mean, variance, weight, bias, eps=eps)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor):
        """With h = (x - mean) / s: dx = weight / s (dy - mean(dy) - h mean(dy h)), means over all processes."""
        x, weight, mean, variance = ctx.saved_tensors
        # PyTorch's kernels divide by zero on a CPU where there is no row; such a process only takes part in the sum.
        straight, own = torch.zeros_like(x), weight.new_zeros(2, len(weight))
        if len(x):
            straight, *sums = torch.ops.aten.native_batch_norm_backward(
                grad, x, weight, mean, variance, None, None, False, ctx.eps, [True, True, True]
            )
            own = torch.stack(sums)
        everyone = own.clone()
        dist.all_reduce(everyone)
        if len(x):
            through = -everyone / ctx.count * weight * (variance + ctx.eps).rsqrt()
            straight += F.batch_norm(x, mean, variance, through[0], through[1], eps=ctx.eps)
        return straight, own[0], own[1], None, None, None, None
