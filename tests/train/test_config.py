import dataclasses
from pathlib import Path

import pytest

from multicam.config import load_config, save_config
from multicam.dataset.objects import Catalogue
from multicam.errors import ConfigError, DataError
from tests.train.toy_pictures import toy_objects
from train.config import NetworkConfig, StageConfig, StagesConfig, TrainConfig

CONFIGS = sorted((Path(__file__).parents[2] / "configs" / "train").glob("*.yaml"))


@pytest.mark.parametrize("path", CONFIGS, ids=lambda p: p.stem)
def test_every_shipped_configuration_survives_saving_and_loading(path: Path, tmp_path: Path) -> None:
    config = load_config(TrainConfig, path)
    save_config(config, tmp_path / "config.yaml")
    assert load_config(TrainConfig, tmp_path / "config.yaml") == config


def test_there_is_a_configuration_for_each_data_set() -> None:
    assert {p.stem for p in CONFIGS} >= {"instruments", "ycbv", "tless", "lmo"}


def test_the_default_weights_are_the_papers() -> None:
    third = StagesConfig().third.weights
    assert dataclasses.astuple(third) == (5, 5, 10, 2, 1, 10)


def test_the_input_must_fit_the_strides() -> None:
    with pytest.raises(ConfigError, match="multiple of 32"):
        NetworkConfig(input_width=320, input_height=240)


def test_a_run_has_at_least_one_epoch() -> None:
    empty = StageConfig(0, 1e-3, 1e-3)
    with pytest.raises(ConfigError, match="one epoch or more"):
        StagesConfig(empty, empty, empty)


def test_the_network_takes_classes_and_keypoints_from_the_catalogue() -> None:
    catalogue, _ = toy_objects()
    config = NetworkConfig("nano").model_config(catalogue)
    assert (config.num_classes, config.num_keypoints) == (2, 8)


def test_objects_with_different_numbers_of_keypoints_are_refused() -> None:
    catalogue, _ = toy_objects()
    lacking = dataclasses.replace(catalogue[2], keypoints=None)
    with pytest.raises(DataError, match="same number of keypoints"):
        NetworkConfig("nano").model_config(Catalogue({2: lacking, 5: catalogue[5]}))
