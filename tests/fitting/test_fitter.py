"""Detections brought to measured depth: boxes before a wall."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from multicam.bundle.adjustment.scene import Body
from multicam.bundle.viewpoints.generate import ViewpointConfig, generate
from multicam.bundle.viewpoints.model import ViewpointModel
from multicam.dataset.objects import Catalogue, ObjectModel
from multicam.errors import ConfigError
from multicam.fitting.config import FitConfig
from multicam.fitting.fitter import Fitter
from multicam.geometry import se3
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import render_depth
from multicam.geometry.symmetry import Symmetries
from multicam.inference.estimator import FrameEstimates, RefusedDetection
from multicam.types import Detection, Frame, ObjectEstimate
from tests.bundle.box_rig import CAMERA, COLORS, WALL, body, cameras, objects, picture
from tests.bundle.box_world import box
from tests.test_adjuster import catalogue

KEYPOINTS = Detection(1, 0.9, np.zeros(4), np.zeros((8, 2)), np.ones((8, 2)), np.ones(8))


def fitter(**options: object) -> Fitter:
    return Fitter(dict.fromkeys((1, 2, 3), body()), catalogue(), FitConfig(**options))


def seen(rng: np.random.Generator, depth: bool = True) -> Frame:
    taken = picture(rng, se3.inverse(cameras()[0]), objects())
    measured = taken.depth.depth if depth and taken.depth is not None else None
    return Frame("left", 0, taken.image, CAMERA, None, measured)


def truth() -> np.ndarray:
    return se3.inverse(cameras()[0]) @ objects()


def estimates(poses: np.ndarray) -> tuple[ObjectEstimate, ...]:
    return tuple(ObjectEstimate(k + 1, 0.9, pose, np.eye(6), KEYPOINTS) for k, pose in enumerate(poses))


def posed(*found: ObjectEstimate) -> FrameEstimates:
    return FrameEstimates(found, ())


def refused(*boxes: np.ndarray) -> FrameEstimates:
    """Detections of the first class without a pose."""
    detections = [replace(KEYPOINTS, box=box, score=0.9 - 0.1 * n) for n, box in enumerate(boxes)]
    return FrameEstimates((), tuple(RefusedDetection(each, "too few keypoints agree") for each in detections))


def corners_off(found: tuple[ObjectEstimate, ...], half_turns: bool = False) -> np.ndarray:
    """Largest error of a corner of each box, millimetres; boxes look the same after a half turn."""
    corners = body().mesh.vertices[:8]
    turns = [np.diag(d) for d in ((1, 1, 1, 1), (1, -1, -1, 1), (-1, 1, -1, 1), (-1, -1, 1, 1))]
    errors = [
        [np.abs(se3.act(e.camera_from_object @ turn, corners) - se3.act(pose, corners)).max() for turn in turns]
        for e, pose in zip(found, truth(), strict=True)
    ]
    return 1e3 * np.array(errors).min(axis=1) if half_turns else 1e3 * np.array(errors)[:, 0]


def wedge() -> Mesh:
    """The box, one end of which is three tenths as high and deep: half turns show."""
    corners = box().vertices.copy()
    corners[corners[:, 0] > 0, 1:] *= 0.3
    return Mesh(corners, box().faces)


def too_far(poses: np.ndarray, factor: float) -> np.ndarray:
    moved = poses.copy()
    moved[:, :3, 3] *= factor
    return moved


@pytest.mark.parametrize("factor", [0.85, 1.0, 1.12, 1.25])
def test_wrong_distances_and_attitudes_are_put_right(rng: np.random.Generator, factor: float) -> None:
    turned = truth() @ se3.exp(np.array([0.1, -0.12, 0.1, 0, 0, 0]))
    start = estimates(too_far(turned, factor))
    (answer,) = fitter().fit([seen(rng)], [posed(*start)])
    found = tuple(sorted(answer, key=lambda each: each.obj_id))
    assert corners_off(start).min() > 5
    moved = np.array([each.detection is None for each in found])
    # The third box is hidden in part, and may stay as it is.
    assert moved[:2].all() and (corners_off(found, half_turns=True)[moved] < 5).all()
    for each in np.array(found, dtype=object)[moved]:
        # Keypoints that were wrong have no say any more, and bars are finite and not absurd.
        assert each.covariance is not None
        std = np.sqrt(np.diag(each.covariance))
        assert (std[:3] >= 0.02).all() and (std[3:] >= 0.003).all() and std.max() < 0.1


WEDGE = se3.from_parts(se3.exp(np.array([0.5, 0.6, 0.3, 0, 0, 0]))[:3, :3], np.array([0.03, -0.02, 0.5]))
"""Where the wedge stands before the camera."""


def wedge_seen(rng: np.random.Generator) -> Frame:
    drawn = render_depth(wedge(), CAMERA, WEDGE)
    image = np.where((drawn > 0)[..., None], COLORS[0], WALL) + rng.normal(scale=8, size=(*drawn.shape, 3))
    return Frame("left", 0, image.clip(0, 255).astype(np.uint8), CAMERA, None, np.where(drawn > 0, drawn, 1.0))


def wedge_fitter(attitudes: int = 300) -> Fitter:
    mesh = wedge()
    known = Catalogue({1: ObjectModel(1, "wedge", mesh.diameter(), Symmetries(), mesh.box)})
    # The wedge agrees with depth in many wrong attitudes; the right one is among the first ten.
    return Fitter({1: Body(wedge_model(), mesh)}, known, FitConfig(attitudes=attitudes, followed=12))


@cache
def wedge_model() -> ViewpointModel:
    return generate(wedge(), ViewpointConfig(subdivisions=3, picture=160))


def wedge_off(found: ObjectEstimate) -> float:
    """Largest error of a corner, millimetres; half a turn about its long axis does not show."""
    same = found.camera_from_object, found.camera_from_object @ np.diag([1.0, -1, -1, 1])
    corners = wedge().vertices
    return 1e3 * min(np.abs(se3.act(pose, corners) - se3.act(WEDGE, corners)).max() for pose in same)


def wedge_box() -> np.ndarray:
    pixels = CAMERA.project(se3.act(WEDGE, wedge().vertices))
    return np.r_[pixels.min(axis=0), pixels.max(axis=0)]


@pytest.mark.parametrize("axis", [1, 2])
def test_a_part_whose_ends_were_taken_for_each_other_is_turned_round(rng: np.random.Generator, axis: int) -> None:
    turned = WEDGE @ np.diag(np.where(np.arange(4) % 3 == axis, 1.0, [-1, -1, -1, 1]))
    # Without other attitudes: half turns alone.
    ((found,),) = wedge_fitter(attitudes=0).fit([wedge_seen(rng)], [posed(*estimates(turned[None]))])
    assert wedge_off(estimates(turned[None])[0]) > 20 and wedge_off(found) < 5


@pytest.mark.parametrize("shift", [(0, 0, 0, 0), (-6, 5, 8, 4)])
def test_a_box_and_depth_are_enough_where_pnp_refused(rng: np.random.Generator, shift: tuple[int, ...]) -> None:
    ((found,),) = wedge_fitter().fit([wedge_seen(rng)], [refused(wedge_box() + shift)])
    assert wedge_off(found) < 5
    assert found.detection is None and found.covariance is not None and found.score == 0.9
    assert wedge_fitter(attitudes=0).fit([wedge_seen(rng)], [refused(wedge_box() + shift)]) == [()]


def test_an_attitude_that_is_all_wrong_is_found_from_the_box(rng: np.random.Generator) -> None:
    wrong = WEDGE @ se3.exp(np.array([0.7, 1.1, -0.9, 0, 0, 0]))
    start = replace(estimates(wrong[None])[0], detection=replace(KEYPOINTS, box=wedge_box()))
    ((found,),) = wedge_fitter().fit([wedge_seen(rng)], [posed(start)])
    assert wedge_off(found) < 5


def test_an_object_that_was_detected_twice_is_one(rng: np.random.Generator) -> None:
    twice = refused(wedge_box(), wedge_box() + np.array([4, -3, 5, 6]))
    ((found,),) = wedge_fitter().fit([wedge_seen(rng)], [twice])
    assert wedge_off(found) < 5
    # The box of nothing but the wall adds nothing.
    ((found,),) = wedge_fitter().fit([wedge_seen(rng)], [refused(wedge_box(), np.array([5.0, 5, 80, 60]))])
    assert wedge_off(found) < 5


def test_what_depth_does_not_confirm_stays_as_it_is(rng: np.random.Generator) -> None:
    elsewhere = truth().copy()
    elsewhere[:, 1, 3] -= 0.25
    start = estimates(elsewhere)
    (found,) = fitter().fit([seen(rng)], [posed(*start)])
    assert found == start
    hopeless = fitter(least=1.1, enough=2.0)
    assert hopeless.fit([seen(rng)], [posed(*estimates(truth()))])[0][0].detection is KEYPOINTS


def test_frames_without_depth_and_unknown_objects_stay_as_they_are(rng: np.random.Generator) -> None:
    start = estimates(too_far(truth(), 1.1))
    blind = seen(rng, depth=False)
    strange = tuple(replace(each, obj_id=9) for each in start)
    nothing = replace(seen(rng), depth=np.zeros((CAMERA.height, CAMERA.width), np.float32))
    given = [posed(*each) for each in (start, strange, start, ())]
    answer = fitter().fit([blind, seen(rng), nothing, seen(rng)], given)
    assert answer == [start, strange, start, ()]


def test_an_estimate_that_depth_confirms_is_not_sought_elsewhere(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    tool, starts = fitter(), []
    real = tool._track
    monkeypatch.setattr(tool, "_track", lambda *each: (starts.append(1), real(*each))[1])
    # The third box is hidden in part.
    tool.fit([seen(rng)], [posed(*estimates(truth())[:2])])
    # Once, and once more with colours learnt where it ended.
    assert len(starts) == 2 * 2


def test_limits_that_contradict_each_other_are_refused() -> None:
    for wrong, name in (
        ({"confirms": 0.02}, "fit.confirms"),
        ({"least": 0.95}, "fit.least"),
        ({"least": 0.0}, "least"),
        ({"attitudes": -1}, "fit.attitudes"),
        ({"followed": 0}, "fit.followed"),
    ):
        with pytest.raises(ConfigError, match=name):
            FitConfig(**wrong)
