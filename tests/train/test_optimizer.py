import math

import pytest
import torch
from torch import nn

from models.config import ModelConfig
from models.detector import Detector
from train.config import StageConfig, StagesConfig
from train.optimizer import MovingAverage, build_optimizer, learning_rate, orthogonalized

STAGES = StagesConfig(StageConfig(2, 1.0, 0.5), StageConfig(0, 9.0, 9.0), StageConfig(1, 0.3, 0.1))


def test_the_rate_falls_along_a_cosine_within_each_stage() -> None:
    rates = [learning_rate(STAGES, 5, 0, step) for step in range(15)]
    assert rates[0] == 1.0 and rates[9] == pytest.approx(0.5)
    assert rates[3] == pytest.approx(0.5 + 0.5 * (1 + math.cos(math.pi * 3 / 9)) / 2)
    assert rates[10] == pytest.approx(0.3) and rates[14] == pytest.approx(0.1)


def test_the_warm_up_is_quadratic_and_ends() -> None:
    flat = StagesConfig(StageConfig(4, 1.0, 1.0), StageConfig(0, 1.0, 1.0), StageConfig(0, 1.0, 1.0))
    rates = [learning_rate(flat, 10, 4, step) for step in range(6)]
    assert rates == pytest.approx([1 / 16, 4 / 16, 9 / 16, 1, 1, 1])


def test_stages_follow_each_other_and_empty_ones_are_skipped() -> None:
    assert [STAGES.at(epoch) for epoch in range(3)] == [(STAGES.first, 0), (STAGES.first, 0), (STAGES.third, 2)]


def test_only_matrices_and_kernels_decay() -> None:
    detector = Detector(ModelConfig(1))
    decayed, kept = build_optimizer(detector, "adamw", 0.05).param_groups
    assert decayed["weight_decay"] == 0.05 and all(p.ndim > 1 for p in decayed["params"])
    assert kept["weight_decay"] == 0 and all(p.ndim <= 1 for p in kept["params"])
    assert len(decayed["params"]) + len(kept["params"]) == len(list(detector.parameters()))


def test_the_average_moves_by_its_decay_and_takes_buffers_along() -> None:
    torch.manual_seed(0)
    detector = Detector(ModelConfig(1))
    average = MovingAverage(detector, 0.5)
    before = average.model.head.levels[0].outputs.bias.clone()
    with torch.no_grad():
        detector.head.levels[0].outputs.bias += 1
        detector.backbone.stem.norm.running_mean += 2
        detector.backbone.stem.norm.num_batches_tracked += 3
    average.update()
    # The first update weighs the past with min(0.5, 2 / 11).
    assert torch.allclose(average.model.head.levels[0].outputs.bias, before + 9 / 11)
    assert torch.allclose(average.model.backbone.stem.norm.running_mean, torch.tensor(18 / 11))
    assert average.model.backbone.stem.norm.num_batches_tracked == 3
    assert not any(p.requires_grad for p in average.model.parameters())


@pytest.mark.parametrize(("kind", "atol"), [(torch.float32, 1e-4), (torch.bfloat16, 0.05)])
@pytest.mark.parametrize("shape", [(3, 6, 20), (1, 20, 6), (1, 5, 5)])
def test_orthogonalized_matrices_keep_their_directions_and_lose_their_sizes(
    shape: tuple[int, ...], kind: torch.dtype, atol: float
) -> None:
    torch.manual_seed(0)
    rank = min(shape[-2:])
    exact = torch.linalg.svd(torch.randn(shape), full_matrices=False)
    matrices = exact.U * torch.logspace(1, -0.5, rank) @ exact.Vh
    along = exact.U.mT @ orthogonalized(matrices.to(kind)).float() @ exact.Vh.mT
    sizes = along.diagonal(dim1=-2, dim2=-1)
    assert (sizes > 0.65).all() and (sizes < 1.25).all()
    assert torch.allclose(along, torch.diag_embed(sizes), atol=atol)


def test_muon_takes_kernels_that_are_matrices_and_leaves_the_rest_to_adamw() -> None:
    for depthwise in (False, True):
        detector = Detector(ModelConfig(2, depthwise=depthwise))
        optimizer = build_optimizer(detector, "muon", 0.05)
        (*plain, kernels) = optimizer.param_groups
        assert [len(group["convolutions"]) for group in plain] == [0, 0]
        names = {id(p): name for name, p in detector.named_parameters()}
        taken = {names[id(p)] for p in kernels["params"]}
        every = [p for group in optimizer.param_groups for p in group["params"]]
        assert len(every) == len(set(every)) == len(names)
        assert "backbone.stem.conv.weight" in taken and not any("outputs" in name or "norm" in name for name in taken)
        assert depthwise == any(name.endswith("within.conv.weight") and name not in taken for name in names.values())


class _Groups(nn.Module):
    def __init__(self, groups: int, size: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(8, 12, size, groups=groups, bias=False)


@pytest.mark.parametrize(("groups", "size", "half"), [(1, 3, False), (2, 3, True), (1, 1, True), (2, 1, False)])
def test_a_step_of_muon_is_orthogonal_in_each_group_as_large_as_one_of_adamw_and_forgets_the_past(
    groups: int, size: int, half: bool
) -> None:
    torch.manual_seed(0)
    module = _Groups(groups, size).to(memory_format=torch.channels_last)
    optimizer = build_optimizer(module, "muon", 0.5, half)
    for group in optimizer.param_groups:
        group["lr"] = 0.1
    before = module.conv.weight.detach().clone()
    module.conv.weight.grad = torch.randn_like(before)
    optimizer.step()
    # Without the decay of 1 - 0.1 * 0.5.
    step = (before * 0.95 - module.conv.weight.detach()) / 0.1
    rows, columns = 12 // groups, 8 // groups * size**2
    matrices = step.reshape(groups, rows, columns) / (0.2 * math.sqrt(max(rows, columns)))
    sizes = torch.linalg.svdvals(matrices)
    assert (sizes > 0.65).all() and (sizes < 1.25).all()
    assert step.square().mean().sqrt() == pytest.approx(0.2, rel=0.3)
    # Of gradients that turn round, the last wins once it has been seen often enough.
    module.conv.weight.grad = -module.conv.weight.grad
    for _ in range(20):
        turned = module.conv.weight.detach().clone()
        optimizer.step()
    assert ((turned * 0.95 - module.conv.weight.detach()) * step).sum() < 0
