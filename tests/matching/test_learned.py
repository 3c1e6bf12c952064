"""The directions in which noise is learnt, and what a learnt model does to estimates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given

from multicam.config import load_config, save_config
from multicam.geometry import se3, so3
from multicam.matching.learned import ClassNoise, NoiseModel, centre_in_camera, from_viewing_axes, viewing_axes
from tests.close import assert_close
from tests.strategies import rotations

CENTRE = np.array([[0.03, -0.05, 0.02]])
STEP = 1e-6


def pose(rotation: np.ndarray) -> np.ndarray:
    return se3.from_parts(rotation, np.array([0.2, -0.1, 0.8]))[None]


@given(rotations())
def test_viewing_axes_are_the_turn_and_the_motion_of_the_centre_by_differences(rotation: np.ndarray) -> None:
    before, axes = pose(rotation), viewing_axes(pose(rotation), CENTRE)[0]
    ray = centre_in_camera(before, CENTRE)[0]
    ray /= np.linalg.norm(ray)
    for direction in np.eye(6):
        after = se3.plus(before, STEP * direction[None])
        turn = so3.log(after[0, :3, :3] @ before[0, :3, :3].T) / STEP
        motion = (centre_in_camera(after, CENTRE) - centre_in_camera(before, CENTRE))[0] / STEP
        found = axes @ direction
        assert found[5] == pytest.approx(ray @ motion, abs=1e-5)
        assert np.linalg.norm(found[3:5]) == pytest.approx(np.linalg.norm(motion - ray * (ray @ motion)), abs=1e-5)
        assert found[2] == pytest.approx(ray @ turn, abs=1e-5)
        assert np.linalg.norm(found[:3]) == pytest.approx(np.linalg.norm(turn), abs=1e-5)


@given(rotations())
def test_the_inverse_axes_undo_the_axes(rotation: np.ndarray) -> None:
    forth, back = viewing_axes(pose(rotation), CENTRE), from_viewing_axes(viewing_axes(pose(rotation), CENTRE))
    assert_close(forth @ back, np.eye(6)[None], atol=1e-12)


@given(rotations())
def test_factors_scale_the_deviations_in_the_directions_of_the_view(rotation: np.ndarray) -> None:
    axes = viewing_axes(pose(rotation), CENTRE)[0]
    back = np.linalg.inv(axes)
    before = back @ np.diag([0.01, 0.02, 0.03, 1e-4, 2e-4, 3e-4]) @ back.T
    model = NoiseModel({7: ClassNoise(2.0, 3.0, 5.0)})
    _, after = model.apply(np.array([7]), pose(rotation), CENTRE, before[None])
    expected = np.diag([0.04, 0.08, 0.12, 9e-4, 18e-4, 75e-4])
    assert_close(axes @ after[0] @ axes.T, expected, atol=1e-12)


def test_a_depth_that_is_always_too_far_is_corrected_along_the_ray() -> None:
    truth = pose(so3.exp(np.array([0.3, -0.2, 0.5])))
    estimate = truth.copy()
    estimate[:, :3, 3] += 0.05 * centre_in_camera(truth, CENTRE)
    model = NoiseModel({7: ClassNoise(too_far=float(np.log(1.05)))})
    corrected, _ = model.apply(np.array([7]), estimate, CENTRE, np.eye(6)[None])
    assert_close(corrected, truth, atol=1e-12)


def test_classes_that_were_not_seen_have_the_common_noise() -> None:
    model = NoiseModel({1: ClassNoise(2.0)}, ClassNoise(3.0))
    assert (model.of(1).attitude, model.of(2).attitude) == (2.0, 3.0)


def test_a_model_is_written_and_read_back(tmp_path: Path) -> None:
    model = NoiseModel({3: ClassNoise(1.2, 0.5, 2.0, 0.01)}, ClassNoise(0.9), kinship=1.5)
    save_config(model, tmp_path / "noise.yaml")
    assert load_config(NoiseModel, tmp_path / "noise.yaml") == model


@pytest.mark.parametrize("make", [lambda: ClassNoise(0.0), lambda: ClassNoise(np.nan), lambda: NoiseModel(kinship=0.5)])
def test_impossible_noise_is_refused(make) -> None:
    with pytest.raises(ValueError, match="must be"):
        make()
