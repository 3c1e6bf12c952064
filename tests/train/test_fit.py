"""What a training begins with."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from multicam.dataset.objects import load_catalogue
from multicam.errors import ConfigError
from multicam.files import read_json
from multicam.progress import SilentProgress
from tests.train.toy_pictures import write_toy_dataset
from train.config import StageConfig, StagesConfig, TrainConfig
from train.distributed import process_group
from train.fit import Run, fit
from train.samples import prepare_objects
from train.validate import Prediction


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


def test_a_view_that_no_picture_shows_is_not_kept_as_learnt(config: TrainConfig) -> None:
    catalogue = load_catalogue(config.data.models)
    assert all(one.canonical.view is None for one in prepare_objects(catalogue, [], {}).values())
    known = prepare_objects(catalogue, [], {5: np.eye(3)})
    assert [obj_id for obj_id, one in known.items() if one.canonical.view is not None] == [5]


def test_labels_of_symmetric_objects_stay_what_the_network_has_learnt(config: TrainConfig, tmp_path: Path) -> None:
    fit(config)
    first = read_json(config.output / "last" / "views.json")
    assert list(first) == ["5"]
    write_toy_dataset(tmp_path / "more", 3, seed=4)
    other = replace(config.data, train=(tmp_path / "more" / "train",))
    alone = replace(config, output=tmp_path / "alone", data=other)
    fit(alone)
    assert read_json(alone.output / "last" / "views.json") != first, "the other poses have another view amid them"
    fit(replace(alone, output=tmp_path / "second", initial=config.output / "last"))
    assert read_json(tmp_path / "second" / "last" / "views.json") == first
    longer = replace(config.stages, second=config.stages.first)
    fit(replace(config, data=other, resume=True, stages=longer))
    assert read_json(config.output / "last" / "views.json") == first


@pytest.fixture
def larger(config: TrainConfig) -> TrainConfig:
    """Two stages of pictures of 128x128, with validation after each."""
    data = replace(config.data, validation=config.data.train)
    network = replace(config.network, input_width=128, input_height=128)
    stages = replace(config.stages, third=config.stages.first)
    return replace(config, data=data, network=network, stages=stages, validate_every=1)


def with_first_scale(config: TrainConfig, scale: float) -> TrainConfig:
    return replace(config, stages=replace(config.stages, first=replace(config.stages.first, scale=scale)))


def test_a_stage_of_smaller_pictures_trains_on_them(larger: TrainConfig) -> None:
    config = with_first_scale(larger, 0.5)
    with process_group(config.device) as group:
        run = Run(config, group, SilentProgress())
    half, whole = (run.dataset[0, 0, replace(config.stages.first, warp=False, scale=scale)] for scale in (0.5, 1.0))
    assert half[0].shape == (64, 64, 3) and whole[0].shape == (128, 128, 3)
    # Pixel centres are integers; above and below, the padding is of whole pixels.
    off = half[1].keypoints + 0.5 - (whole[1].keypoints + 0.5) / 2
    assert np.abs(off[..., 0]).max() < 1e-9 and np.abs(off[..., 1]).max() < 0.51
    state = fit(config)
    assert (state.input_width, state.input_height) == (128, 128)


def test_figures_on_pictures_of_another_size_are_not_compared(
    larger: TrainConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    best: list[dict[str, float]] = []
    sizes: list[tuple[int, ...]] = []

    def compare(new: dict[str, float], so_far: dict[str, float]) -> bool:
        best.append(so_far)
        return True

    def judge(predictions: list[Prediction], objects: object) -> dict[str, float]:
        sizes.append(predictions[0].image.shape[:2])
        return {"recall": float(len(sizes))}

    monkeypatch.setattr("train.fit.is_better", compare)
    monkeypatch.setattr("train.fit.figures", judge)
    fit(with_first_scale(larger, 0.5))
    assert sizes == [(64, 64), (128, 128)] and best == [{}, {}]
    fit(replace(larger, output=larger.output.with_name("same")))
    assert sizes[2:] == [(128, 128)] * 2 and best[2:] == [{}, {"recall": 3.0}]


def test_the_last_stage_must_be_of_whole_pictures(larger: TrainConfig) -> None:
    small = replace(larger.stages.third, scale=0.5)
    with pytest.raises(ConfigError, match=r"the last stage has a scale of 0.5; it must be 1"):
        replace(larger, stages=replace(larger.stages, third=small))


def test_a_scale_that_the_network_cannot_take_is_refused() -> None:
    stage = StageConfig(1, 1e-3, 1e-3, scale=0.33)
    with pytest.raises(ConfigError, match=r"stage's scale of 0.33, .*multiple of 32"):
        TrainConfig(stages=StagesConfig(first=stage))
