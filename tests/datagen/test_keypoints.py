"""`multicam datagen keypoints` on a models folder that has none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from datagen.commands.keypoints import KeypointsConfig, write_keypoints
from multicam.dataset.bop_writer import write_models
from multicam.dataset.objects import load_catalogue
from multicam.errors import DataError
from multicam.progress import SilentProgress
from tests.toy_objects import BRACKET, toy_catalogue, toy_meshes


@pytest.fixture
def models(tmp_path: Path) -> Path:
    write_models(tmp_path, toy_catalogue(), toy_meshes())
    (tmp_path / "keypoints.json").unlink()
    return tmp_path


def test_every_object_gets_keypoints_on_its_surface(models: Path) -> None:
    write_keypoints(KeypointsConfig(models, count=6), SilentProgress())
    for model in load_catalogue(models).objects.values():
        assert model.keypoints is not None
        assert model.keypoints.shape == (6, 3)
        low, high = model.load_mesh().box
        assert np.all((model.keypoints >= low - 1e-6) & (model.keypoints <= high + 1e-6))


def test_keypoints_that_networks_depend_on_are_not_overwritten_silently(models: Path) -> None:
    write_keypoints(KeypointsConfig(models), SilentProgress())
    with pytest.raises(DataError, match="--replace"):
        write_keypoints(KeypointsConfig(models), SilentProgress())
    write_keypoints(KeypointsConfig(models, replace=True, seed=1), SilentProgress())
    assert load_catalogue(models)[BRACKET].keypoints is not None
