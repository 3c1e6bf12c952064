"""Manifests, and what is found wrong with a data set; no Blender: pictures are drawn by NumPy."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datagen.commands.verify import VerifyConfig, main, verify
from datagen.config import DatagenConfig
from datagen.jobs.verify import find_splits, verify_split
from datagen.pictures.generate import is_finished, missing_images, scene_folder
from datagen.pictures.manifest import FREE, read_manifest, write_manifest
from datagen.pictures.output import claim
from multicam.config import save_config
from multicam.dataset.bop_writer import SceneWriter
from multicam.errors import DataError
from multicam.files import read_json, write_json
from multicam.progress import SilentProgress
from tests.dataset.labelled import labelled_image


@pytest.fixture
def made(models: Path, tmp_path: Path) -> DatagenConfig:
    """Two whole scenes of two pictures."""
    config = DatagenConfig(models=models, output=tmp_path / "set", images=4, images_per_scene=2)
    claim(config.output / "train" / "config.yaml", config, FREE)
    for scene in range(2):
        writer = SceneWriter(scene_folder(config, scene))
        for im_id in range(2):
            writer.add(im_id, labelled_image(np.random.default_rng(im_id)))
        write_manifest(writer.folder, config, scene)
    return config


def problems(config: DatagenConfig) -> tuple[str, ...]:
    return verify_split(config.output / config.split, 2).problems


def test_a_whole_data_set_has_no_problems(made: DatagenConfig) -> None:
    report = verify_split(made.output / "train", 2)
    assert (report.problems, report.scenes, report.pictures) == ((), 2, 4)
    assert report.files == sum(p.is_file() for p in (made.output / "train").glob("0*/**/*")) - 2
    verify(VerifyConfig(made.output), SilentProgress())
    assert find_splits(made.output) == find_splits(made.output / "train") == [made.output / "train"]


def _change(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[-20] ^= 1
    path.write_bytes(bytes(data))


def _double_row(scene: Path) -> None:
    path = scene / "scene_gt.json"
    path.write_text(path.read_text().replace('"1":', '"0":', 1))


def _drop_row(scene: Path) -> None:
    path = scene / "scene_keypoints.json"
    table = read_json(path)
    del table["1"]
    write_json(path, table)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda scene: (scene / "rgb" / "000001.jpg").unlink(), "000001.jpg is missing"),
        (lambda scene: (scene / "depth" / "000000.png").write_bytes(b"to"), "is torn: 2 bytes of"),
        (lambda scene: _change(scene / "rgb" / "000000.jpg"), "is not what was written"),
        (lambda scene: (scene / "rgb" / "000001.png").write_bytes(b"x"), "is not in the manifest"),
        (lambda scene: (scene / "mask" / ".000001_000000-abc_d3fg.png").write_bytes(b""), "left by a killed writer"),
        (lambda scene: (scene / "manifest.json").write_text("{"), "is not valid JSON"),
        (lambda scene: (scene / "manifest.json").unlink(), "1 unfinished scenes (000001), which lack 0 pictures"),
        (_double_row, "scene_gt.json has image 0 2 times"),
        (_drop_row, "scene_keypoints.json lacks image 1"),
        (lambda scene: (scene.parent / "000007").mkdir(), "000007 is no scene of this data set"),
    ],
)
def test_damage_is_named(made: DatagenConfig, damage: Callable[[Path], object], words: str) -> None:
    damage(scene_folder(made, 1))
    found = problems(made)
    assert any(words in problem for problem in found), found
    assert not any("train/000000" in problem for problem in found)
    with pytest.raises(DataError, match="not as its manifests say"):
        main([str(made.output)])


def test_a_doubled_picture_is_named_though_the_manifest_has_it(made: DatagenConfig) -> None:
    folder = scene_folder(made, 0)
    (folder / "rgb" / "000001.png").write_bytes((folder / "rgb" / "000001.jpg").read_bytes())
    write_manifest(folder, made, 0)
    assert any("rgb/000001 is there 2 times" in problem for problem in problems(made))


def test_scenes_of_another_configuration_or_place_are_named(made: DatagenConfig) -> None:
    write_manifest(scene_folder(made, 0), replace(made, width=32), 0)
    write_manifest(scene_folder(made, 1), made, 0)
    found = problems(made)
    assert any("made with another configuration" in problem for problem in found)
    assert any("000001 holds scene 0 of seed 0" in problem for problem in found)


def test_what_is_missing_is_counted_with_the_command_that_goes_on(made: DatagenConfig) -> None:
    save_config(replace(made, images=9), made.output / "train" / "config.yaml")
    (found,) = problems(made)
    assert "3 unfinished scenes (000002, 000003, 000004), which lack 5 pictures" in found
    assert f"multicam datagen render --config {made.output / 'train' / 'config.yaml'}" in found


def test_a_manifest_spares_reading_the_labels(made: DatagenConfig) -> None:
    (scene_folder(made, 0) / "scene_gt.json").write_text("torn")
    assert is_finished(made, 0)
    manifest = read_manifest(scene_folder(made, 0))
    assert manifest is not None
    assert (manifest.scene, manifest.seed, manifest.images) == (0, 0, 2)
    # More pictures than it has are another matter.
    assert not is_finished(replace(made, images_per_scene=3), 0)


def test_the_hash_is_of_what_decides_the_pictures(made: DatagenConfig) -> None:
    hashes = set()
    for config in (made, replace(made, images=5, workers=3, executor="ray"), replace(made, samples=7)):
        write_manifest(scene_folder(made, 0), config, 0)
        manifest = read_manifest(scene_folder(made, 0))
        assert manifest is not None
        hashes.add(manifest.config)
    assert len(hashes) == 2


def test_a_folder_that_another_version_began_is_refused(made: DatagenConfig) -> None:
    write_json(made.output / "train" / "generator.json", {"version": 1})
    with pytest.raises(DataError, match="begun by version 1 of the generator"):
        claim(made.output / "train" / "config.yaml", made, FREE)


def test_a_folder_without_a_data_set_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="holds no data set"):
        find_splits(tmp_path)


def test_a_writer_tidies_what_a_killed_one_left(made: DatagenConfig) -> None:
    folder = scene_folder(made, 0)
    truth = read_json(folder / "scene_gt.json")
    del truth["1"]
    write_json(folder / "scene_gt.json", truth)
    leftover = folder / "rgb" / ".000001-abcdefgh.jpg"
    leftover.write_bytes(b"")
    writer = SceneWriter(folder)
    assert missing_images(made, 0) == [1]
    writer.tidy()
    assert sorted(path.name for path in (folder / "rgb").iterdir()) == ["000000.jpg"]
    assert {path.name[:6] for path in (folder / "mask").iterdir()} == {"000000"}
    writer.add(1, labelled_image(np.random.default_rng(1)))
    assert list(json.loads((folder / "scene_gt.json").read_text())) == ["0", "1"]
