"""A small network with lively random weights, and a checkpoint of it as training writes them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from export import cli
from models.config import ModelConfig
from models.detector import Detector
from multicam.dataset.objects import Catalogue
from tests.toy_objects import toy_catalogue
from train.checkpoint import RunState, save_checkpoint
from train.optimizer import MovingAverage

WIDTH, HEIGHT = 96, 64
ROWS = 20


def pictures(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, HEIGHT, WIDTH, 3) uint8: coarse colours with fine noise, so that cells differ from each other."""
    coarse = rng.uniform(0, 255, (count, HEIGHT // 16, WIDTH // 16, 3)).repeat(16, axis=1).repeat(16, axis=2)
    return np.clip(coarse + rng.normal(scale=20, size=coarse.shape), 0, 255).astype(np.uint8)


def lively_detector(config: ModelConfig, seed: int = 0) -> Detector:
    """Random weights whose outputs depend on the picture; fresh ones answer nearly the same everywhere."""
    torch.manual_seed(seed)
    detector = Detector(config).eval()
    images = torch.from_numpy(pictures(np.random.default_rng(seed), 8)).permute(0, 3, 1, 2).float()
    last = [layer for level in detector.head.levels for layer in (level.outputs, level.classes[-1])]
    with torch.no_grad():
        for module in detector.modules():
            if isinstance(module, torch.nn.Conv2d):
                module.weight.normal_(std=1.7 / module.weight[0].numel() ** 0.5)
            if isinstance(module, torch.nn.BatchNorm2d | torch.nn.BatchNorm1d):
                module.running_mean.normal_(std=0.1)
                module.running_var.uniform_(0.7, 1.4)
        hooks = [layer.register_forward_hook(_scale_to_half) for layer in last]
        detector(images)
    for hook in hooks:
        hook.remove()
    return detector


def _scale_to_half(layer: torch.nn.Conv2d, _inputs: object, output: torch.Tensor) -> None:
    """Makes every channel of the layer vary by one half about zero over the pictures just seen."""
    factor = 0.5 / output.std(dim=(0, 2, 3))
    layer.bias.copy_(factor * (layer.bias - output.mean(dim=(0, 2, 3))))
    layer.weight.mul_(factor[:, None, None, None])


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
    save_checkpoint(folder, detector, MovingAverage(detector, 0.999), optimizer, config, catalogue, {}, state)
    return folder


@pytest.fixture(scope="session")
def exported(checkpoint: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The checkpoint as a file, by the command."""
    path = tmp_path_factory.mktemp("exported") / "toy.onnx"
    cli.main(["--checkpoint", str(checkpoint), "--output", str(path), "--rows", str(ROWS)])
    return path


@pytest.fixture
def quick_export(exported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exports again by copying, for tests of what comes after the file is written."""
    monkeypatch.setattr(cli, "write_onnx", lambda _d, _m, path: path.write_bytes(exported.read_bytes()))


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Small layers gain nothing from threads, and on a busy machine they wait for each other."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
