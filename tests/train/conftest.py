"""A training that takes seconds and moves nothing."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.train.toy_pictures import write_toy_dataset
from train.config import DataConfig, NetworkConfig, StageConfig, StagesConfig, TrainConfig


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
