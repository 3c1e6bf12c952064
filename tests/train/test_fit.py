"""What a training begins with."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from tests.train.toy_pictures import write_toy_dataset
from train.config import DataConfig, NetworkConfig, StageConfig, StagesConfig, TrainConfig
from train.fit import fit


@pytest.fixture
def config(tmp_path: Path) -> TrainConfig:
    write_toy_dataset(tmp_path, 2)
    # Steps too small to be seen.
    stage = StageConfig(1, 1e-12, 1e-12, oks_sigma=0.25)
    none = replace(stage, epochs=0)
    return TrainConfig(
        output=tmp_path / "run",
        data=DataConfig((tmp_path / "train",), (), tmp_path / "models"),
        network=NetworkConfig("nano", "pafpn", (8, 16, 32), 16, 64, 64),
        stages=StagesConfig(stage, none, none),
        batch_size=2,
        workers=0,
        threads=1,
    )


def weights(folder: Path, file: str = "model") -> dict[str, torch.Tensor]:
    """What is learnt of a checkpoint, without the running statistics of its norms."""
    return {n: t for n, t in load_file(folder / f"{file}.safetensors").items() if n.endswith(("weight", "bias"))}


def furthest(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> float:
    return max((one[name] - other[name]).abs().max().item() for name in one)


def test_a_run_begins_with_the_weights_of_another_and_resumes_with_its_own(config: TrainConfig) -> None:
    fit(config)
    second = replace(config, output=config.output.with_name("second"), seed=7)
    fit(replace(second, initial=config.output / "last"))
    first = weights(config.output / "last", "ema")
    assert furthest(first, weights(second.output / "last")) < 1e-6
    assert furthest(first, weights(second.output / "last", "ema")) < 1e-6
    # Another seed alone begins elsewhere; and what is resumed looks at the other run no more.
    third = replace(second, output=config.output.with_name("third"))
    fit(third)
    assert furthest(first, weights(third.output / "last")) > 0.01
    there = weights(third.output / "last")
    longer = replace(third.stages, second=replace(third.stages.first))
    fit(replace(third, resume=True, initial=config.output / "last", stages=longer))
    assert furthest(there, weights(third.output / "last")) < 1e-6
