"""A small network with lively random weights, and a checkpoint of it as training writes them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from models.config import ModelConfig
from models.detector import Detector
from multicam.dataset.objects import Catalogue
from tests.toy_objects import toy_catalogue
from train.checkpoint import RunState, save_checkpoint
from train.optimizer import MovingAverage

WIDTH, HEIGHT = 96, 64


def lively_detector(config: ModelConfig, seed: int = 0) -> Detector:
    """Random weights whose outputs depend on the picture; fresh ones answer nearly the same everywhere."""
    torch.manual_seed(seed)
    detector = Detector(config)
    with torch.no_grad():
        for level in detector.head.levels:
            level.outputs.weight.normal_(std=0.3)
            level.classes[-1].weight.normal_(std=0.5)
        detector.train()
        for _ in range(10):
            detector.decode(detector(torch.rand(4, 3, HEIGHT, WIDTH) * 255), 10)
    return detector.eval()


@pytest.fixture(scope="session")
def model_config() -> ModelConfig:
    return ModelConfig(num_classes=len(toy_catalogue().objects), size="nano")


@pytest.fixture(scope="session")
def detector(model_config: ModelConfig) -> Detector:
    return lively_detector(model_config)


@pytest.fixture(scope="session")
def checkpoint(tmp_path_factory: pytest.TempPathFactory, detector: Detector, model_config: ModelConfig) -> Path:
    return write_checkpoint(tmp_path_factory.mktemp("run") / "best", detector, model_config, toy_catalogue())


def write_checkpoint(folder: Path, detector: Detector, config: ModelConfig, catalogue: Catalogue) -> Path:
    optimizer = torch.optim.AdamW(detector.parameters())
    state = RunState(epoch=3, step=0, input_width=WIDTH, input_height=HEIGHT, metrics={"add_0.1d": 0.25})
    save_checkpoint(folder, detector, MovingAverage(detector, 0.999), optimizer, config, catalogue, state)
    return folder


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Small layers gain nothing from threads, and on a busy machine they wait for each other."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
