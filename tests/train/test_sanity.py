import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from multicam.dataset.bop_reader import read_image
from multicam.errors import DataError
from multicam.progress import SilentProgress
from tests.train.toy_pictures import write_toy_dataset
from train.config import DataConfig, NetworkConfig, TrainConfig
from train.sanity import Verdict, sanity_check

REACHED = Verdict(90, {"box": 0.9, "rays": 0.2}, {"box": 0.1, "rays": 0.01}, 1.0, 0.9, 1.0, 2.0)


@pytest.fixture
def config(tmp_path: Path) -> TrainConfig:
    write_toy_dataset(tmp_path, 10)
    return TrainConfig(
        output=tmp_path / "run",
        data=DataConfig((tmp_path / "train",), (), tmp_path / "models"),
        network=NetworkConfig("nano", "pafpn", (8, 16, 32), 64, 160, 128),
        least_positives=6,
        threads=1,
    )


@pytest.mark.slow
def test_good_pictures_are_learnt_by_heart(config: TrainConfig) -> None:
    verdict = sanity_check(config, SilentProgress())
    assert verdict.passed and verdict.recall == 1 and verdict.last["total"] < verdict.first["total"]
    assert "keypoints" in verdict.describe()
    # Eight pictures in two rows of four.
    assert read_image(config.output / "sanity.jpg").shape == (2 * 128, 4 * 160, 3)
    assert [path.name for path in config.output.iterdir()] == ["sanity.jpg"]


@pytest.mark.slow
def test_labels_that_contradict_the_pictures_fail(config: TrainConfig) -> None:
    pictures = sorted((config.data.train[0] / "000001" / "rgb").iterdir())
    for path in pictures[1:]:
        shutil.copy(pictures[0], path)
    verdict = sanity_check(config, SilentProgress(), steps=60)
    assert not verdict.passed and verdict.steps == 60
    assert "sanity.jpg" in verdict.reason()


def test_each_failure_says_where_to_look() -> None:
    assert REACHED.passed
    cases = {
        "rays did not fall": replace(REACHED, last={"box": 0.1, "rays": 0.3}, recall=0.5),
        "objects are not found": replace(REACHED, recall=0.5),
        "lacks a symmetry": replace(REACHED, keypoint_px=3.0),
        "keypoints.json": replace(REACHED, add_recall=0.1),
    }
    for words, verdict in cases.items():
        assert not verdict.passed and words in verdict.reason()


def test_pictures_without_anything_to_learn_are_refused(config: TrainConfig) -> None:
    with pytest.raises(DataError, match="nothing to learn"):
        sanity_check(replace(config, minimum_visible=2.0), SilentProgress())
