"""Values that cross package borders are checked when they are made."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from multicam.geometry.camera import Camera
from multicam.types import Frame, FrameSet, ObjectEstimate, Registration

CAMERA = Camera.from_focal(50.0, 64, 48)


def frame(name: str = "a", shape: tuple[int, ...] = (48, 64, 3), dtype: type = np.uint8) -> Frame:
    return Frame(name, 0, np.zeros(shape, dtype=dtype), CAMERA)


def test_a_frame_has_the_size_its_camera_says() -> None:
    assert frame().image.shape == (48, 64, 3)


@pytest.mark.parametrize(("shape", "dtype"), [((64, 48, 3), np.uint8), ((48, 64), np.uint8), ((48, 64, 3), np.float32)])
def test_a_frame_of_another_size_or_type_is_refused(shape: tuple[int, ...], dtype: type) -> None:
    with pytest.raises(ValueError, match=r"frame of camera a: image is .* its camera says uint8 \(48, 64, 3\)"):
        frame(shape=shape, dtype=dtype)


def test_a_frame_set_holds_each_camera_once() -> None:
    assert len(FrameSet(0, (frame("a"), frame("b"))).frames) == 2
    with pytest.raises(ValueError, match="holds each camera once; got \\['a', 'b', 'a'\\]"):
        FrameSet(0, (frame("a"), frame("b"), frame("a")))


@pytest.mark.parametrize("pose", [np.full((4, 4), np.nan), np.eye(3), np.diag([1.0, 1, 1, np.inf])])
def test_a_pose_that_is_no_finite_matrix_is_refused(pose: np.ndarray) -> None:
    with pytest.raises(ValueError, match="pose of object 7 is not a finite 4x4 matrix"):
        ObjectEstimate(7, 0.5, pose)


def test_values_cannot_be_changed() -> None:
    estimate = ObjectEstimate(1, 0.5, np.eye(4))
    with pytest.raises(dataclasses.FrozenInstanceError):
        estimate.score = 0.9  # pyright: ignore[reportAttributeAccessIssue]
    assert Registration(()).refusals == {}
