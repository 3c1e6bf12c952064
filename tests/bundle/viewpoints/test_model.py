from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from multicam.bundle.viewpoints.generate import ViewpointConfig, generate, look_along
from multicam.bundle.viewpoints.model import ViewpointModel, load, save
from multicam.errors import DataError
from multicam.geometry import se3
from tests.bundle.viewpoints.shapes import box

CONFIG = ViewpointConfig(subdivisions=2, contour_points=20, surface_points=10, picture=60)


@pytest.fixture(scope="module")
def model() -> ViewpointModel:
    return generate(box(), CONFIG)


def test_a_loaded_model_equals_the_saved_one(model: ViewpointModel, tmp_path: Path) -> None:
    save(model, tmp_path / "box.npy")
    loaded = load(tmp_path / "box.npy")
    for field in fields(model):
        np.testing.assert_array_equal(getattr(loaded, field.name), getattr(model, field.name))
    assert [path.name for path in tmp_path.iterdir()] == ["box.npy"]


def test_a_loaded_model_is_mapped_and_like_any_model_read_only(model: ViewpointModel, tmp_path: Path) -> None:
    save(model, tmp_path / "box.npy")
    loaded = load(tmp_path / "box.npy")
    for one in (model, loaded):
        for field in fields(one):
            values = getattr(one, field.name)
            assert field.name == "offset_step" or (type(values) is np.ndarray and values.dtype == np.float32)
            assert field.name == "offset_step" or not values.flags.writeable
    mapped = loaded.contour_offset
    while type(mapped.base) is np.ndarray:
        mapped = mapped.base
    assert isinstance(mapped.base, np.memmap)
    assert loaded.contour_offset[3].flags.c_contiguous


@given(seed=st.integers(0, 10000))
def test_the_closest_view_is_found_as_by_angles(model: ViewpointModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera_from_object = se3.exp(rng.normal(size=6) * [2, 2, 2, 0.3, 0.3, 1])
    place = -camera_from_object[:3, :3].T @ camera_from_object[:3, 3]
    angles = [np.arccos(np.clip(-place @ d / np.linalg.norm(place), -1, 1)) for d in model.direction.astype(np.float64)]
    assert angles[model.closest_view(camera_from_object)] == pytest.approx(min(angles), abs=1e-3)


def test_each_view_is_the_closest_of_its_own_camera(model: ViewpointModel) -> None:
    rotation = look_along(model.direction.astype(np.float64))
    for view in range(len(rotation)):
        assert model.closest_view(se3.from_parts(rotation[view], np.array([0, 0, 0.5]))) == view


def test_an_object_at_the_camera_has_a_view(model: ViewpointModel) -> None:
    assert model.closest_view(np.eye(4)) == 0


def test_files_that_are_no_models_are_refused_by_name(model: ViewpointModel, tmp_path: Path) -> None:
    path = tmp_path / "box.npy"
    with pytest.raises(DataError, match="does not exist"):
        load(path)
    save(model, path)
    whole = path.read_bytes()
    for damaged in (b"", whole[:50], whole[: len(whole) // 2], b"x" + whole[1:]):
        path.write_bytes(damaged)
        with pytest.raises(DataError, match=r"box\.npy is no viewpoint model"):
            load(path)
    half = len(whole) // 2
    path.write_bytes(whole[:half] + bytes(9000) + whole[half + 9000 :])
    with pytest.raises(DataError, match=r"box\.npy is damaged"):
        load(path)
    np.save(path, np.zeros((3, 4)))
    with pytest.raises(DataError, match="float64"):
        load(path)
