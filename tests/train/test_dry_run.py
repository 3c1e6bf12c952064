import time
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from multicam.errors import ConfigError
from multicam.progress import SilentProgress
from tests.train.toy_pictures import write_toy_dataset
from train import measure as measuring
from train.cli import main
from train.config import DataConfig, NetworkConfig, StageConfig, StagesConfig, TrainConfig
from train.dry_run import describe, duration, limit
from train.fit import fit
from train.loader import TrainingSet
from train.measure import measure


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TrainConfig:
    monkeypatch.setattr(measuring, "_SECONDS", 0.0)
    monkeypatch.setattr(measuring, "_LEAST", 1)
    write_toy_dataset(tmp_path, 4)
    train = (tmp_path / "train",)
    stage = StageConfig(2, 1e-4, 1e-4, oks_sigma=0.25)
    stages = StagesConfig(stage, replace(stage, epochs=0), replace(stage, epochs=1, warp=False))
    network = NetworkConfig("nano", "pafpn", (8, 16, 32), 16, 64, 64)
    data = DataConfig(train, train, tmp_path / "models")
    return TrainConfig(tmp_path / "run", False, data, network, stages, batch_size=2, workers=0, threads=1)


def test_a_dry_run_tells_what_the_run_costs_and_writes_nothing(config: TrainConfig) -> None:
    costs = measure(config, SilentProgress())
    assert not config.output.exists()
    assert costs.shapes["images"] == (2, 3, 64, 64)
    assert costs.shapes["cells pose_vectors"] == (2, 8 * 8 + 4 * 4 + 2 * 2, 128)
    assert costs.shapes["classifier keypoints"][1:] == (8, 2)
    assert [stage.name for stage in costs.stages] == ["first", "third"]
    assert costs.steps == 2 and costs.validations == 1 and costs.memory >= costs.memory_before > 1e8
    assert costs.stages[0].seconds == pytest.approx(2 * 2 * 2 / costs.stages[0].together)
    console = Console(width=200)
    with console.capture() as page:
        console.print(describe(config, costs))
    assert "GFLOP" in page.get() and "limited by" in page.get()

    fit(config)
    last = sum(file.stat().st_size for file in (config.output / "last").iterdir())
    # Last, best and one being written, and some TensorBoard.
    assert 3 * last == pytest.approx(costs.disk, rel=0.05)


def test_a_slow_loader_is_named(config: TrainConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    load = TrainingSet.__getitem__

    def slowly(dataset: TrainingSet, place: tuple[int, int, bool]):
        time.sleep(1.0)
        return load(dataset, place)

    monkeypatch.setattr(TrainingSet, "__getitem__", slowly)
    costs = measure(config, SilentProgress())
    assert {limit(stage) for stage in costs.stages} == {"loader"}
    assert all(stage.loader < 1.1 and stage.together < stage.network for stage in costs.stages)


def test_torchrun_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WORLD_SIZE", "2")
    with pytest.raises(ConfigError, match="torchrun started 2, run without it"):
        main(["--dry-run"])


def test_only_one_look_at_a_time() -> None:
    with pytest.raises(ConfigError, match="give one of them"):
        main(["--dry-run", "--sanity"])


def test_durations_read_well() -> None:
    assert [duration(seconds) for seconds in (8, 89, 600, 7200)] == ["8 s", "89 s", "10 min", "2.0 h"]
