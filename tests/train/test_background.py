"""Other backgrounds behind rendered objects, from files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from multicam.dataset.bop_reader import read_image, read_scene
from multicam.dataset.bop_writer import InstanceLabels, LabelledImage, SceneWriter
from multicam.errors import DataError
from multicam.geometry.camera import Camera
from train.background import Backgrounds
from train.config import AugmentConfig
from train.samples import Picture

SHAPE = (12, 16)
MASK = np.zeros(SHAPE, bool)
MASK[3:9, 4:10] = True


def picture(folder: Path, alpha: np.ndarray | None) -> Picture:
    """A white square in a black picture, written and read."""
    labels = InstanceLabels(
        1, np.eye(4), np.array([4.0, 3, 10, 9]), MASK, MASK, 1.0, 36, np.zeros((0, 2)), np.zeros(0, bool)
    )
    camera = Camera(np.array([[20.0, 0, 8], [0, 20, 6], [0, 0, 1]]), SHAPE[1], SHAPE[0])
    image = np.repeat(MASK[..., None], 3, axis=2).astype(np.uint8) * 255
    depth = np.zeros(SHAPE, np.float32)
    SceneWriter(folder / "000000").add(0, LabelledImage(camera, np.eye(4), image, depth, (labels,), alpha, 100))
    (record,) = read_scene(folder / "000000")
    assert record.rgb_path is not None
    return Picture(record, read_image(record.rgb_path), None)


@pytest.fixture
def backgrounds(tmp_path: Path) -> Backgrounds:
    (tmp_path / "grey").mkdir()
    cv2.imwrite(str(tmp_path / "grey" / "a.png"), np.full((5, 5, 3), 100, np.uint8))
    return Backgrounds(AugmentConfig(backgrounds=tmp_path / "grey", background=1.0))


def test_masks_cut_hard(tmp_path: Path, backgrounds: Backgrounds) -> None:
    image = backgrounds.behind(picture(tmp_path, None), np.random.default_rng(0)).image
    assert np.all(image[MASK] > 240)
    assert np.all(image[~MASK] == 100)


def test_alpha_blends_the_edges(tmp_path: Path, backgrounds: Backgrounds) -> None:
    alpha = MASK.astype(np.float32)
    alpha[3, 4:10] = 0.5
    image = backgrounds.behind(picture(tmp_path, alpha), np.random.default_rng(0)).image
    assert np.allclose(image[3, 4:10], 100 + 128 / 255 * 155, atol=4)
    assert np.all(image[4:9, 4:10] > 240)
    assert np.all(image[~MASK] == 100)


def test_a_data_set_without_masks_is_refused(tmp_path: Path, backgrounds: Backgrounds) -> None:
    bare = picture(tmp_path, None)
    bare = replace(bare, record=replace(bare.record, mask_visib_paths=()))
    with pytest.raises(DataError, match="no mask_visib files"):
        backgrounds.behind(bare, np.random.default_rng(0))


def test_a_folder_without_pictures_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="holds no picture"):
        Backgrounds(AugmentConfig(backgrounds=tmp_path))
