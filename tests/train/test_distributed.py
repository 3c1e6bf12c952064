import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from multicam.config import save_config
from tests.train.toy_pictures import write_toy_dataset
from train.checkpoint import find_checkpoint, load_state
from train.config import AugmentConfig, DataConfig, LossWeights, NetworkConfig, StageConfig, StagesConfig, TrainConfig

ROOT = Path(__file__).parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
TORCHRUN = (sys.executable, "-m", "torch.distributed.run", "--standalone")
WORKER = str(Path(__file__).with_name("distributed_worker.py"))
FILES = ("model.safetensors", "ema.safetensors", "training.safetensors")


@pytest.fixture
def config(tmp_path: Path) -> TrainConfig:
    """Three stages of two steps on eight pictures."""
    write_toy_dataset(tmp_path, 8)
    weights = LossWeights(rays=10.0)
    stages = StagesConfig(
        StageConfig(1, 2e-5, 2e-5, "truth", oks_sigma=0.25),
        StageConfig(1, 2e-5, 2e-5, oks_sigma=0.25),
        StageConfig(1, 2e-5, 2e-5, oks_sigma=0.25, warp=False, weights=weights),
    )
    return TrainConfig(
        output=tmp_path / "run",
        data=DataConfig((tmp_path / "train",), (), tmp_path / "models"),
        network=NetworkConfig("nano", "pafpn", (16, 32), 16, 64, 64),
        stages=stages,
        augment=AugmentConfig(mosaic=0.5),
        batch_size=4,
        warmup_steps=6,
        workers=0,
        threads=1,
    )


def start(config: TrainConfig, *command: str) -> subprocess.Popen[bytes]:
    """Starts a command that ends with a configuration file."""
    file = config.output.with_suffix(".yaml")
    save_config(config, file)
    return subprocess.Popen([*command, str(file)], cwd=ROOT, env=ENVIRONMENT)


def tensors(run: TrainConfig, file: str) -> dict[str, Tensor]:
    return load_file(run.output / "last" / file)


@pytest.mark.slow
def test_two_processes_learn_what_one_learns(config: TrainConfig) -> None:
    one, two = config, replace(config, batch_size=2, output=config.output.with_name("two"))
    assert start(one, sys.executable, WORKER).wait(300) == 0
    assert start(two, *TORCHRUN, "--nproc-per-node", "2", WORKER).wait(300) == 0
    for file in FILES[:2]:
        expected, found = tensors(one, file), tensors(two, file)
        assert expected.keys() == found.keys()
        for name, value in expected.items():
            # Running statistics of late layers are far above 1; all else is compared as it stands.
            assert torch.allclose(found[name].double(), value.double(), rtol=1e-5, atol=1e-5), (file, name)
    # Adam's steps do not show the size of a gradient, but its moments do.
    expected, found = tensors(one, FILES[2]), tensors(two, FILES[2])
    names = [name for name in expected if name.startswith("exp_avg/")]
    whole = torch.cat([expected[name].flatten() for name in names])
    difference = torch.cat([(found[name] - expected[name]).flatten() for name in names])
    assert difference.norm() < 1e-3 * whole.norm()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_killed_run_ends_as_if_nothing_had_happened(config: TrainConfig, number: signal.Signals) -> None:
    whole, cut = config, replace(config, output=config.output.with_name("cut"), resume=True)
    train = (sys.executable, "-m", "train.cli", "--config")
    assert start(whole, *train).wait(300) == 0
    process = start(cut, *train)
    # The first checkpoint is written at the end of the first epoch; the signal comes during the second or third.
    while find_checkpoint(cut.output / "last") is None:
        assert process.poll() is None
        time.sleep(0.002)
    process.send_signal(number)
    assert process.wait(300) == (-signal.SIGKILL if number == signal.SIGKILL else 130)
    assert load_state(cut.output / "last").epoch < config.stages.epochs
    assert start(cut, *train).wait(300) == 0
    assert load_state(cut.output / "last") == load_state(whole.output / "last")
    for file in FILES:
        expected, found = tensors(whole, file), tensors(cut, file)
        assert expected.keys() == found.keys()
        for name, value in expected.items():
            assert torch.equal(found[name], value), (file, name)
