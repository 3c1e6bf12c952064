"""The whole way through Blender, on tiny pictures."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from datagen.config import DatagenConfig, ObjectsConfig
from datagen.jobs.generate import generate
from datagen.pictures.output import copy_models
from datagen.scenes.stock import Stock
from multicam.config import load_config, save_config
from multicam.dataset.bop_reader import ImageRecord, list_scenes, read_depth, read_image, read_scene
from multicam.errors import DataError
from multicam.files import read_json, write_json
from multicam.geometry import se3
from multicam.geometry.camera import Camera

pytestmark = pytest.mark.blender

ROOT = Path(__file__).parents[2]


def config_for(models: Path, output: Path) -> DatagenConfig:
    return DatagenConfig(
        models=models, output=output, images=6, images_per_scene=3, width=64, height=48, samples=1,
        objects=ObjectsConfig(assembled_fraction=0.5, loose=(4, 5)), seed=4,
    )  # fmt: skip


@pytest.fixture(scope="module")
def rendered(models: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("rendered")
    generate(config_for(models, output))
    return output


def records(output: Path) -> list[ImageRecord]:
    return [record for scene in list_scenes(output / "train") for record in read_scene(scene)]


def labels(output: Path) -> dict[str, bytes]:
    """Every file but the pictures themselves and the configuration, which names the folder."""
    paths = [p for p in output.rglob("*") if p.is_file() and p.suffix != ".jpg" and p.name != "config.yaml"]
    return {str(path.relative_to(output)): path.read_bytes() for path in paths}


def test_the_data_set_reads_back(rendered: Path, models: Path) -> None:
    found = records(rendered)
    assert [(r.scene_id, r.im_id) for r in found] == [(s, i) for s in (0, 1) for i in (0, 1, 2)]
    for record in found:
        assert record.rgb_path is not None
        image = read_image(record.rgb_path)
        assert image.shape == (48, 64, 3)
        assert 40 < image.mean() < 215
    assert sum(len(r.instances) for r in found) > 12
    assert labels(rendered)["models/models_info.json"] == (models / "models_info.json").read_bytes()
    assert load_config(DatagenConfig, rendered / "train" / "config.yaml") == config_for(models, rendered)


def test_pictures_of_a_scene_share_a_world(rendered: Path) -> None:
    for scene in list_scenes(rendered / "train"):
        truth = [
            se3.inverse(record.camera_from_world) @ instance.camera_from_object
            for record in read_scene(scene)
            if record.camera_from_world is not None
            for instance in record.instances
        ]
        distinct = np.unique(np.round(np.stack(truth)[:, :3, 3], 6), axis=0)
        objects = max(len(r.instances) for r in read_scene(scene))
        assert objects <= len(distinct) < len(truth)


def test_points_of_the_surface_masks_and_depth_agree(rendered: Path, stock: Stock) -> None:
    checked = 0
    for record in records(rendered):
        assert record.depth_path is not None
        assert record.camera_matrix is not None
        depth = read_depth(record.depth_path, record.depth_scale)
        camera = Camera(record.camera_matrix, 64, 48)
        for path, instance in zip(record.mask_visib_paths, record.instances, strict=True):
            mask = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            near_mask = cv2.dilate(mask, np.ones((3, 3), np.uint8)) > 0
            mesh = stock.meshes[instance.obj_id]
            samples = mesh.sample_surface(200, np.random.default_rng(0))
            points = se3.act(instance.camera_from_object, np.concatenate((mesh.vertices, samples)))
            pixels = camera.project(points)
            inside = camera.contains(pixels) & (points[:, 2] > 0)
            columns, rows = np.rint(pixels[inside]).astype(int).T
            on_surface = np.abs(depth[rows, columns] - points[inside, 2]) < 2e-3
            assert near_mask[rows, columns][on_surface].all()
            checked += int(on_surface.sum())
            assert instance.box is not None
            assert np.all(pixels > np.maximum(instance.box[:2], (-64.5, -48.5)) - 1e-6) or np.any(pixels < -48)
    assert checked > 200


def test_silhouettes_of_both_renderers_agree(rendered: Path) -> None:
    overlaps = []
    for record in records(rendered):
        for path, instance in zip(record.mask_visib_paths, record.instances, strict=True):
            visible = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) > 0
            whole = cv2.imread(str(path).replace("mask_visib", "mask"), cv2.IMREAD_GRAYSCALE) > 0
            assert not np.any(visible & ~cv2.dilate(whole.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool))
            # Only an object that nothing hides can be compared as a whole.
            if instance.visible_fraction and instance.visible_fraction > 0.98:
                overlaps.append((visible & whole).sum() / (visible | whole).sum())
    assert len(overlaps) >= 5
    assert min(overlaps) >= 0.97


def test_a_killed_run_continues_with_the_same_labels(rendered: Path, models: Path, tmp_path: Path) -> None:
    output, scratch = tmp_path / "killed", tmp_path / "scratch"
    scratch.mkdir()
    save_config(config_for(models, output), tmp_path / "config.yaml")
    command = [sys.executable, "-m", "datagen.cli", "render", "--config", str(tmp_path / "config.yaml")]
    environment = os.environ | {"TMPDIR": str(scratch)}
    process = subprocess.Popen(command, cwd=ROOT, env=environment, stderr=subprocess.DEVNULL)
    first = output / "train" / "000000" / "scene_gt.json"
    deadline = time.monotonic() + 300
    while not (first.is_file() and read_json(first)):
        assert process.poll() is None, "the run ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert len(records(output)) < 6
    generate(config_for(models, output))
    assert labels(output) == labels(rendered)
    # The orphaned Blender process ends with its input and takes its pictures with it.
    while any(scratch.iterdir()):
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_a_torn_picture_is_made_again(rendered: Path, models: Path, tmp_path: Path) -> None:
    output = tmp_path / "torn"
    copy_models(models, output / "models")
    for path in sorted((rendered / "train").rglob("*")):
        if path.is_file():
            target = output / "train" / path.relative_to(rendered / "train")
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(path.read_bytes())
    scene = output / "train" / "000001"
    truth = read_json(scene / "scene_gt.json")
    del truth["1"]
    write_json(scene / "scene_gt.json", truth)
    (scene / "rgb" / "000001.jpg").write_bytes(b"torn")
    (scene / "manifest.json").unlink()
    (scene / "depth" / ".000001-abcdefgh.png").write_bytes(b"to")
    generate(config_for(models, output))
    assert labels(output) == labels(rendered)
    assert read_image(scene / "rgb" / "000001.jpg").shape == (48, 64, 3)


def test_another_configuration_is_refused_and_more_pictures_are_not(
    rendered: Path, models: Path, tmp_path: Path
) -> None:
    config = config_for(models, rendered)
    with pytest.raises(DataError, match="different: width, seed"):
        generate(replace(config, seed=5, width=32))
    other = tmp_path / "models"
    write_json(other / "models_info.json", {})
    with pytest.raises(DataError, match="other models"):
        copy_models(other, rendered / "models")
    before = labels(rendered)
    generate(replace(config, images=4))
    assert labels(rendered) == before
