"""A small models folder of convex toys, with one mounted group."""

from __future__ import annotations

from pathlib import Path

import pytest

from datagen.scenes.stock import Stock, load_stock
from multicam.dataset.bop_writer import write_models
from multicam.files import write_json
from tests.toy_objects import PLATE, ROD, toy_catalogue, toy_meshes


@pytest.fixture(scope="session")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six toys and the group "post": the rod stands on the plate."""
    folder = tmp_path_factory.mktemp("toys") / "models"
    turn = [1.0, 0, 0, 0, 1, 0, 0, 0, 1]
    parts = [
        {"obj_id": PLATE, "name": "plate", "R_group_from_object": turn, "t_group_from_object": [0.0, 0, 0]},
        {"obj_id": ROD, "name": "rod", "R_group_from_object": turn, "t_group_from_object": [0.0, 0, 101]},
    ]
    write_json(folder / "assemblies.json", [{"name": "post", "parts": parts}])
    write_models(folder, toy_catalogue(), toy_meshes())
    return folder


@pytest.fixture(scope="session")
def stock(models: Path) -> Stock:
    """The same, loaded."""
    return load_stock(models)
