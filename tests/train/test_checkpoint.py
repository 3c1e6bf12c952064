from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch

from models.config import ModelConfig
from models.detector import Detector
from multicam.dataset.objects import Catalogue
from multicam.errors import DataError, ModelError, MulticamError
from multicam.geometry import so3
from multicam.geometry.symmetry import Symmetries
from tests.train.toy_pictures import toy_objects
from train.checkpoint import (
    RunState,
    find_checkpoint,
    load_state,
    load_views,
    load_weights,
    restore,
    save_checkpoint,
    take_over,
)
from train.config import OptimizerName
from train.optimizer import MovingAverage, build_optimizer

CONFIG = ModelConfig(2, "nano", bins=16)
VIEWS = {5: so3.exp(np.array([0.3, -0.2, 0.9]))}


def fresh(
    seed: int = 0, config: ModelConfig = CONFIG, optimizer: OptimizerName = "adamw"
) -> tuple[Detector, MovingAverage, torch.optim.Optimizer]:
    torch.manual_seed(seed)
    detector = Detector(config)
    return detector, MovingAverage(detector, 0.9), build_optimizer(detector, optimizer, 0.05)


def step(detector: Detector, average: MovingAverage, optimizer: torch.optim.Optimizer) -> None:
    raw = detector(torch.rand(1, 3, 64, 64) * 255)
    optimizer.zero_grad()
    (raw.boxes.mean() + raw.class_logits.mean()).backward()
    for group in optimizer.param_groups:
        group["lr"] = 1e-3
    optimizer.step()
    average.update()


def save(folder: Path, run: tuple[Detector, MovingAverage, torch.optim.Optimizer], state: RunState) -> None:
    save_checkpoint(folder, *run, CONFIG, toy_objects()[0], VIEWS, state)


@pytest.mark.parametrize("optimizer", get_args(OptimizerName))
def test_a_restored_run_continues_bit_by_bit(tmp_path: Path, optimizer: OptimizerName) -> None:
    run = fresh(optimizer=optimizer)
    step(*run)
    save(tmp_path / "last", run, RunState(0, 1, 64, 64, ema_updates=1))
    step(*run)
    other = fresh(seed=5, optimizer=optimizer)
    state = restore(tmp_path / "last", *other)
    # The picture of the next step is random: it repeats only if the random state came back too.
    step(*other)
    assert state == RunState(0, 1, 64, 64, ema_updates=1)
    for (name, a), b in zip(run[0].state_dict().items(), other[0].state_dict().values(), strict=True):
        assert torch.equal(a, b), name
    for a, b in zip(run[1].model.state_dict().values(), other[1].model.state_dict().values(), strict=True):
        assert torch.equal(a, b)


def test_export_gets_network_classes_and_averaged_weights(tmp_path: Path) -> None:
    run = fresh()
    step(*run)
    save(tmp_path / "last", run, RunState(0, 1, 64, 64))
    config, catalogue, weights = load_weights(tmp_path / "last")
    assert config == CONFIG and catalogue.obj_ids == (2, 5)
    assert catalogue[5].symmetries and not catalogue[2].symmetries
    for name, tensor in run[1].model.state_dict().items():
        assert torch.equal(weights[name], tensor)


def test_a_training_begins_with_the_averaged_weights_of_one_with_other_classes(tmp_path: Path) -> None:
    run = fresh()
    step(*run)
    save(tmp_path / "last", run, RunState(0, 1, 64, 64))
    other = fresh(5, ModelConfig(7, "nano", bins=16))[0]
    before = {name: tensor.clone() for name, tensor in other.state_dict().items()}
    new = take_over(tmp_path / "last", other)
    # One layer of each level tells classes apart.
    assert len(new) == 2 * len(CONFIG.strides) and all("class" in name for name in new)
    for name, tensor in run[1].model.state_dict().items():
        assert torch.equal(other.state_dict()[name], before[name] if name in new else tensor), name


def test_views_are_those_of_the_objects_that_the_other_training_knew(tmp_path: Path) -> None:
    folder = tmp_path / "last"
    save(folder, fresh(), RunState(0, 1, 64, 64))
    catalogue, _ = toy_objects()
    brick, plate = catalogue[2], catalogue[5]
    assert plate.keypoints is not None
    # Numbers may differ between trainings; the keypoints say which object it is.
    renamed = Catalogue({1: replace(plate, obj_id=1), 5: replace(brick, obj_id=5, symmetries=plate.symmetries)})
    views = load_views(folder, renamed)
    assert list(views) == [1] and np.array_equal(views[1], VIEWS[5])
    moved = Catalogue({5: replace(plate, keypoints=plate.keypoints + 0.001)})
    plain = Catalogue({5: replace(plate, symmetries=Symmetries())})
    assert load_views(folder, moved) == {} and load_views(folder, plain) == {}


def test_a_checkpoint_without_views_says_what_may_follow(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    save(tmp_path / "last", fresh(), RunState(0, 1, 64, 64))
    (tmp_path / "last" / "views.json").unlink()
    assert load_views(tmp_path / "last", toy_objects()[0]) == {}
    with pytest.raises(DataError, match=r"objects\.json"):
        load_views(tmp_path / "nowhere", toy_objects()[0])
    assert caplog.text.count("views.json") == 1, "of a folder that is no checkpoint the views are not what is missing"
    assert "labels of objects with symmetries may differ" in caplog.text


@pytest.mark.parametrize("text", ["[1]", '{"5": [1, 2]}', '{"x": []}', '{"5": "no"}'])
def test_damaged_views_are_named(tmp_path: Path, text: str) -> None:
    save(tmp_path / "last", fresh(), RunState(0, 1, 64, 64))
    (tmp_path / "last" / "views.json").write_text(text)
    with pytest.raises(DataError, match=r"views\.json"):
        load_views(tmp_path / "last", toy_objects()[0])


def test_weights_of_another_size_are_refused(tmp_path: Path) -> None:
    save(tmp_path / "last", fresh(), RunState(0, 1, 64, 64))
    with pytest.raises(ModelError, match=r"holds a nano network.*only \d+% of the network") as refused:
        take_over(tmp_path / "last", fresh(0, ModelConfig(2, "tiny", bins=16))[0])
    assert "leave `initial` out" in str(refused.value)


def test_nothing_in_a_checkpoint_is_pickled(tmp_path: Path) -> None:
    run = fresh()
    step(*run)
    save(tmp_path / "last", run, RunState(0, 1, 64, 64))
    names = {p.name for p in (tmp_path / "last").iterdir()}
    assert names == {
        "model.safetensors",
        "ema.safetensors",
        "training.safetensors",
        "model.json",
        "objects.json",
        "state.json",
        "views.json",
    }


def test_a_kill_while_a_checkpoint_is_replaced_loses_nothing(tmp_path: Path) -> None:
    run = fresh()
    save(tmp_path / "last", run, RunState(1, 0, 64, 64))
    # Killed after the old one stepped aside, and with a half-written new one.
    (tmp_path / "last").rename(tmp_path / ".last-old")
    (tmp_path / ".last-new").mkdir()
    assert find_checkpoint(tmp_path / "last") == tmp_path / "last"
    assert load_state(tmp_path / "last").epoch == 1
    save(tmp_path / "last", run, RunState(2, 0, 64, 64))
    assert load_state(tmp_path / "last").epoch == 2
    assert [p.name for p in tmp_path.iterdir()] == ["last"]


def test_another_network_is_refused_in_one_sentence(tmp_path: Path) -> None:
    save(tmp_path / "last", fresh(), RunState(0, 0, 64, 64))
    with pytest.raises(ModelError, match="holds another network"):
        restore(tmp_path / "last", *fresh(config=ModelConfig(3, "nano", bins=16)))


@pytest.mark.parametrize("name", ["model.safetensors", "state.json", "training.safetensors", "model.json"])
def test_a_damaged_file_is_named(tmp_path: Path, name: str) -> None:
    save(tmp_path / "last", fresh(), RunState(0, 0, 64, 64))
    path = tmp_path / "last" / name
    path.write_bytes(path.read_bytes()[:20])
    with pytest.raises(MulticamError, match=name):
        restore(tmp_path / "last", *fresh())
        load_weights(tmp_path / "last")


def test_a_folder_without_checkpoint_is_no_checkpoint(tmp_path: Path) -> None:
    assert find_checkpoint(tmp_path / "last") is None
    with pytest.raises(DataError, match="does not exist"):
        load_weights(tmp_path / "last")
