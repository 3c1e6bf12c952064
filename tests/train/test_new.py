from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from multicam.config import load_config
from multicam.dataset.bop_writer import write_models
from multicam.dataset.objects import Catalogue
from multicam.errors import DataError
from tests.train.toy_pictures import HEIGHT, WIDTH, toy_objects, write_toy_dataset
from train.choices import (
    Machine,
    Pictures,
    choose_batch,
    choose_bins,
    choose_input,
    choose_size,
    choose_stages,
    expected_pictures,
    input_sizes,
)
from train.cli import main
from train.config import WINDOWS, TrainConfig

LAPTOP = Machine(cores=2, gpu_memory=0, bf16=True)
SERVER = Machine(cores=32, gpu_memory=24_000_000_000, bf16=True)
PICTURES = Pictures(4000, 200, 640, 480, small=60, large=200, rendered=True)


def test_a_new_configuration_loads_and_gives_its_reasons(tmp_path: Path) -> None:
    write_toy_dataset(tmp_path, 3)
    file = tmp_path / "train.yaml"
    main(["new", "--models", str(tmp_path / "models"), "--output", str(file)])
    config = load_config(TrainConfig, file)
    assert config.data.models == tmp_path / "models" and config.data.train == (tmp_path / "train",)
    assert config.network.input_width >= WIDTH and config.network.input_height >= HEIGHT
    lines = file.read_text().splitlines()
    keys = [row for row, line in enumerate(lines) if line and line[0].isalpha()]
    assert {lines[row].split(":")[0] for row in keys} == set(yaml.safe_load(file.read_text()))
    # A blank line and a comment stand before every group of options.
    groups = [row for row in keys if not lines[row - 1] or lines[row - 1].startswith("#")]
    assert len(groups) >= 9 and all(lines[row - 1].startswith("# ") for row in groups)


def test_what_to_do_next_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    models = tmp_path / "my parts" / "models"
    write_models(models, *toy_objects())
    with caplog.at_level("INFO"):
        main(["new", "--models", str(models), "--output", str(tmp_path / "a.yaml")])
    commands = [line.strip() for line in caplog.text.splitlines() if "multicam " in line]
    assert [" ".join(line.split()[:3]) for line in commands[:2]] == ["multicam datagen render"] * 2
    assert f"--output '{models.parent}'" in commands[0] and "--split val" in commands[1]
    assert [line.split()[-1] for line in commands[2:4]] == ["--sanity", "--dry-run"]


def test_models_without_keypoints_are_refused_with_the_command_that_makes_them(tmp_path: Path) -> None:
    catalogue, meshes = toy_objects()
    bare = Catalogue({i: replace(known, keypoints=None) for i, known in catalogue.objects.items()})
    write_models(tmp_path / "models", bare, meshes)
    with pytest.raises(DataError, match=r"toy_2, toy_5; `multicam datagen keypoints --models"):
        main(["new", "--models", str(tmp_path / "models"), "--output", str(tmp_path / "a.yaml")])
    assert not (tmp_path / "a.yaml").exists()


def test_models_without_a_mesh_are_refused(tmp_path: Path) -> None:
    write_models(tmp_path / "models", *toy_objects())
    (tmp_path / "models" / "obj_000005.ply").unlink()
    with pytest.raises(DataError, match="no mesh for toy_5"):
        main(["new", "--models", str(tmp_path / "models"), "--output", str(tmp_path / "a.yaml")])


def test_a_file_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("mine")
    with pytest.raises(DataError, match="exists"):
        main(["new", "--models", str(tmp_path), "--output", str(tmp_path / "a.yaml")])
    assert (tmp_path / "a.yaml").read_text() == "mine"


def test_the_network_grows_with_classes_and_machine() -> None:
    assert [choose_size(n, LAPTOP)[0] for n in (9, 20, 40)] == ["nano", "tiny", "s"]
    assert [choose_size(9, replace(SERVER, gpu_memory=g * 10**9))[0] for g in (6, 12, 24)] == ["tiny", "s", "m"]


def test_small_objects_ask_for_a_larger_input_but_not_for_more_than_the_pictures_have() -> None:
    assert choose_input(PICTURES, LAPTOP)[:2] == (352, 288)
    assert choose_input(replace(PICTURES, small=100), LAPTOP)[:2] == (320, 256)
    width, height, reason = choose_input(replace(PICTURES, small=5), LAPTOP)
    assert (width, height) == (640, 480) and "bring the cameras nearer" in reason
    assert choose_input(replace(PICTURES, width=320, height=240, small=5), SERVER)[:2] == (320, 256)


def test_a_network_that_learns_from_windows_sees_more_than_they_show() -> None:
    assert input_sizes(PICTURES, 352, 288) == {"input_width": 352, "input_height": 288}
    assert input_sizes(replace(PICTURES, window=0.5), 320, 256) == {
        "input_width": 640, "input_height": 480, "window_width": 320, "window_height": 256
    }  # fmt: skip


def test_a_step_learns_from_as_many_windows_as_whole_pictures() -> None:
    windows = replace(PICTURES, width=320, height=240, window=0.5)
    batch, reason = choose_batch("nano", 640 * 480, windows, LAPTOP)
    assert batch * WINDOWS == choose_batch("nano", 320 * 256, PICTURES, LAPTOP)[0] == 8
    assert "put together of 4 windows" in reason
    assert choose_batch("nano", 640 * 480, replace(windows, count=5), LAPTOP)[0] == 1


def test_renders_of_small_parts_are_windows_and_those_of_long_ones_whole() -> None:
    screws = expected_pictures(3000, 0, [0.02, 0.03, 0.05])
    nails = expected_pictures(3000, 0, [0.05, 0.1, 0.34])
    assert (screws.window, nails.window) == (0.5, 1.0)
    # As many pixels as they span in the picture, from 0.6 m and with a focal length of 1.15 widths.
    assert screws.large == pytest.approx(640 * 1.15 * 0.046 / 0.6)
    assert nails.small == pytest.approx(320 * 1.15 * 0.06 / 0.6)
    assert input_sizes(nails, 320, 256) == {"input_width": 320, "input_height": 256}


def test_bins_stay_fine_on_large_objects() -> None:
    assert [choose_bins(PICTURES, width)[0] for width in (320, 640)] == [128, 256]


def test_a_gpu_takes_a_batch_that_fits_and_learning_rates_follow() -> None:
    assert choose_batch("m", 640 * 480, PICTURES, SERVER)[0] == 16
    assert choose_batch("m", 1280 * 960, PICTURES, SERVER)[0] == 4
    stage = {"epochs": 3, "learning_rate_start": 1e-3, "learning_rate_end": 1e-4}
    recipe = {"stages": {"first": stage, "second": {**stage, "epochs": 1}}, "batch_size": 8}
    stages, _ = choose_stages(recipe, 9, 4000, 16, LAPTOP)
    assert stages["first"]["learning_rate_start"] == 2e-3
    # 60 000 + 9 x 20 000 pictures are 60 epochs of 4000, three quarters of them in the first stage.
    assert [stage["epochs"] for stage in stages.values()] == [45, 15]


def test_few_pictures_do_not_make_endless_epochs() -> None:
    recipe = {"stages": {"first": {"epochs": 1, "learning_rate_start": 1e-3, "learning_rate_end": 1e-3}}}
    stages, reason = choose_stages(recipe, 9, 100, 8, LAPTOP)
    assert stages["first"]["epochs"] == 400 and "render more" in reason
