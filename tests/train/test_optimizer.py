import math

import pytest
import torch

from models.config import ModelConfig
from models.detector import Detector
from train.config import StageConfig, StagesConfig
from train.optimizer import MovingAverage, build_optimizer, learning_rate

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
    decayed, kept = build_optimizer(detector, 0.05).param_groups
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
