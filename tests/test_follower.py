"""Boxes followed between detections by a headset and two static cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from multicam import pipeline
from multicam.dataset.runs import StepResult
from multicam.errors import ConfigError
from multicam.follower import FollowConfig, Follower
from multicam.geometry import se3
from multicam.scenegraph.graph import SceneGraph
from multicam.types import Frame, FrameSet, ObjectEstimate
from tests.bundle.box_rig import CAMERA, body, cameras, objects, picture
from tests.test_adjuster import CONFIG, NAMES, camera_errors, catalogue, entered, moment

STEP_NS = 200_000_000
SHIFT = np.array([0.01, 0.02, -0.01, 0.012, -0.01, 0.008])
"""Of the headset from step to step, radians and metres."""


def follower(every: int = 100) -> Follower:
    return Follower(dict.fromkeys((1, 2, 3), body()), FollowConfig(every=every))


def started(rng: np.random.Generator, with_follower: Follower) -> tuple[SceneGraph, StepResult]:
    """After a first step with estimates of all boxes, all but exact."""
    frame_set, found = moment(rng)
    exact = [
        tuple(
            replace(each, camera_from_object=pose) for each, pose in zip(view, se3.inverse(at) @ objects(), strict=True)
        )
        for view, at in zip(found, cameras(), strict=True)
    ]
    graph, result = entered((frame_set, exact))
    with_follower.learn(frame_set.frames, result, detected=True)
    return graph, result


def later(
    rng: np.random.Generator, number: int, boxes: np.ndarray | None = None, depth: bool = True, moves: bool = True
) -> FrameSet:
    """A step in which the headset has moved on and the boxes may stand elsewhere, or be fewer."""
    at = cameras().copy()
    if moves:
        at[0] = at[0] @ se3.exp(number * SHIFT)
    frames: list[Frame] = []
    for name, world_from_camera in zip(NAMES, at, strict=True):
        taken = picture(rng, se3.inverse(world_from_camera), objects() if boxes is None else boxes, depth)
        measured = None if taken.depth is None else taken.depth.depth
        tracked = world_from_camera if name == "headset" else None
        frames.append(Frame(name, number * STEP_NS, taken.image, CAMERA, tracked, measured))
    return FrameSet(number * STEP_NS, tuple(frames))


def errors(found: list[tuple[ObjectEstimate, ...]], at: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Millimetres, of all estimates in all cameras."""
    return np.array(
        [
            1e3 * np.linalg.norm((world_from_camera @ each.camera_from_object - boxes[each.obj_id - 1])[:3, 3])
            for view, world_from_camera in zip(found, at, strict=True)
            for each in view
        ]
    )


@pytest.mark.parametrize(("depth", "bound"), [(True, 2.0), (False, 8.0)])
def test_boxes_are_followed_while_the_headset_moves(rng: np.random.Generator, depth: bool, bound: float) -> None:
    tool = follower()
    graph, _ = started(rng, tool)
    for number in range(1, 5):
        frame_set = later(rng, number, depth=depth)
        found = tool.look(frame_set.frames)
        assert found is not None and [len(view) for view in found] == [3, 3, 3]
        at = cameras().copy()
        at[0] = at[0] @ se3.exp(number * SHIFT)
        assert np.median(errors(found, at, objects())) < bound
        graph, result = pipeline.step(graph, frame_set, found, catalogue(), CONFIG)
        assert all(result.camera(name).status in ("placed", "tracked") for name in NAMES)
        assert max(camera_errors(result)) < 10
        tool.learn(frame_set.frames, result, detected=False)


@pytest.mark.parametrize("depth", [True, False])
def test_what_it_states_of_its_poses_covers_their_errors(rng: np.random.Generator, depth: bool) -> None:
    tool = follower()
    started(rng, tool)
    found = tool.look(later(rng, 1, depth=depth).frames)
    assert found is not None
    at = cameras().copy()
    at[0] = at[0] @ se3.exp(SHIFT)
    squared, across, along = [], [], []
    for view, world_from_camera in zip(found, at, strict=True):
        for each in view:
            assert each.covariance is not None
            shift = se3.minus(se3.inverse(world_from_camera) @ objects()[each.obj_id - 1], each.camera_from_object)
            squared.append(shift @ np.linalg.solve(each.covariance, shift))
            turn = each.camera_from_object[:3, :3]
            std = np.sqrt(np.diag(turn @ each.covariance[3:, 3:] @ turn.T))
            across.append(std[:2].max())
            along.append(std[2])
    assert np.mean(np.array(squared) < 12.6) > 0.8
    # A contour says to a pixel or two, of 1.7 mm, where an object is in the picture, but little of its depth.
    assert 8e-4 < np.median(across) < 6e-3
    assert (np.median(along) < 1.5 * np.median(across)) == depth


def test_a_box_that_leaves_the_picture_is_let_go(rng: np.random.Generator) -> None:
    tool = follower()
    started(rng, tool)
    moved = cameras().copy()
    moved[0] = moved[0] @ se3.exp(np.array([0.0, 0.6, 0, 0, 0, 0]))
    taken = picture(rng, se3.inverse(moved[0]), objects())
    assert taken.depth is not None
    frame = Frame("headset", STEP_NS, taken.image, CAMERA, moved[0], taken.depth.depth)
    found = tool.look((frame,))
    assert found is not None and 0 < len(found[0]) < 3
    assert errors(found, moved[:1], objects()).max() < 5


def test_colours_are_learnt_anew_where_the_network_has_looked(rng: np.random.Generator) -> None:
    tool = follower()
    _, result = started(rng, tool)
    for detected, followed in ((False, False), (True, True)):
        frames = tuple(replace(f, image=np.ascontiguousarray(f.image[..., ::-1])) for f in later(rng, 1).frames)
        tool.learn(frames, result, detected)
        still = tuple(
            replace(f, image=np.ascontiguousarray(f.image[..., ::-1])) for f in later(rng, 1, depth=False).frames
        )
        assert (tool.look(still) is not None) == followed


def test_the_network_looks_at_every_nth_step_and_at_the_first(rng: np.random.Generator) -> None:
    tool = follower(every=3)
    assert tool.look(later(rng, 0).frames) is None
    graph, _ = started(rng, tool)
    asked = []
    for number in range(1, 7):
        frame_set = later(rng, number, moves=False)
        found = tool.look(frame_set.frames)
        asked.append(found is None)
        graph, result = pipeline.step(graph, frame_set, found or moment(rng, number)[1], catalogue(), CONFIG)
        tool.learn(frame_set.frames, result, detected=found is None)
    assert asked == [False, False, True, False, False, True]


def test_a_box_that_is_taken_away_is_lost_and_the_network_asked(rng: np.random.Generator) -> None:
    tool = follower()
    started(rng, tool)
    assert tool.look(later(rng, 1).frames) is not None
    gone = later(rng, 1, boxes=objects()[:2], depth=False)
    assert tool.look(gone.frames) is None


def test_a_box_that_its_colours_do_not_show_is_not_followed(rng: np.random.Generator) -> None:
    tool = follower()
    frame_set, found = moment(rng)
    _, result = entered((frame_set, found))
    # The headset sees nothing but wall.
    blank = replace(frame_set.frames[0], image=np.full_like(frame_set.frames[0].image, 90), depth=None)
    frames = (blank, *frame_set.frames[1:])
    tool.learn(frames, result, detected=True)
    followed = tool.look(frames)
    assert followed is not None and [len(view) for view in followed] == [0, 3, 3]


def test_a_box_that_is_pushed_is_followed_to_its_new_place(rng: np.random.Generator) -> None:
    tool = follower()
    started(rng, tool)
    pushed = objects().copy()
    pushed[1] = pushed[1] @ se3.exp(np.array([0.03, 0, 0.02, 0.008, -0.006, 0.004]))
    found = tool.look(later(rng, 1, boxes=pushed, moves=False).frames)
    assert found is not None
    assert np.median(errors(found, cameras(), pushed)) < 2


def test_without_the_headsets_motion_it_would_lose_them(rng: np.random.Generator) -> None:
    tool = follower()
    started(rng, tool)
    far = later(rng, 12)
    assert tool.look(far.frames) is not None
    blind = tuple(replace(frame, tracked_world_from_camera=None) for frame in far.frames)
    found = tool.look(blind)
    at = cameras().copy()
    at[0] = at[0] @ se3.exp(12 * SHIFT)
    assert found is None or np.max(errors(found[:1], at[:1], objects())) > 10


def test_a_camera_without_picture_or_pose_is_left_out(rng: np.random.Generator) -> None:
    tool = follower()
    started(rng, tool)
    frames = later(rng, 1).frames
    found = tool.look((*frames[:2], replace(frames[2], camera_id="new")))
    assert found is not None and [len(view) for view in found] == [3, 3, 0]


def test_settings_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"follow.every is 0"):
        FollowConfig(every=0)
    with pytest.raises(ConfigError, match="region must not be null"):
        FollowConfig(tracking=replace(FollowConfig().tracking, region=None))
