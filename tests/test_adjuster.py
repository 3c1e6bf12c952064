"""Bundle adjustment within the pipeline: boxes on a table before a headset and two static cameras with depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from multicam import pipeline
from multicam.adjuster import Adjuster, BundleConfig
from multicam.bundle.adjustment.frames import ideal_picture
from multicam.dataset.objects import Catalogue, ObjectModel
from multicam.dataset.runs import StepResult
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.symmetry import Symmetries
from multicam.pipeline import PipelineConfig
from multicam.scenegraph.graph import SceneGraph
from multicam.types import Frame, FrameSet, ObjectEstimate
from tests.bundle.box_rig import CAMERA, body, cameras, objects, picture
from tests.bundle.box_world import box

NAMES = ("headset", "left", "right")
CONFIG = PipelineConfig()
STD = np.repeat([0.03, 0.006], 3)
"""Of the estimates, radians and metres."""
STEP_NS = 2_000_000_000

Seen = tuple[FrameSet, list[tuple[ObjectEstimate, ...]]]


def catalogue() -> Catalogue:
    """The box under the numbers 1, 2 and 3, for each has its colour."""
    mesh = box()
    return Catalogue({n: ObjectModel(n, f"box {n}", mesh.diameter(), Symmetries(), mesh.box) for n in (1, 2, 3)})


def adjuster(**options: object) -> Adjuster:
    return Adjuster(dict.fromkeys((1, 2, 3), body()), replace(BundleConfig(), **options))


def moment(rng: np.random.Generator, number: int = 0, depth: bool = True, at: np.ndarray | None = None) -> Seen:
    """What the rig takes at a step, and noisy estimates of all boxes; `at` are the cameras if they moved."""
    stands, frames, found = cameras() if at is None else at, list[Frame](), list[tuple[ObjectEstimate, ...]]()
    for name, world_from_camera in zip(NAMES, stands, strict=True):
        taken = picture(rng, se3.inverse(world_from_camera), objects(), depth)
        tracked = world_from_camera if name == "headset" else None
        measured = None if taken.depth is None else taken.depth.depth
        frames.append(Frame(name, number * STEP_NS, taken.image, CAMERA, tracked, measured))
        poses = se3.plus(se3.inverse(world_from_camera) @ objects(), STD * rng.normal(size=(3, 6)))
        found.append(tuple(ObjectEstimate(n + 1, 0.9, pose, np.diag(STD**2)) for n, pose in enumerate(poses)))
    return FrameSet(number * STEP_NS, tuple(frames)), found


def entered(
    seen: Seen, graph: SceneGraph | None = None, with_adjuster: Adjuster | None = None
) -> tuple[SceneGraph, StepResult]:
    graph = pipeline.start(NAMES[0], NAMES[1:], CONFIG) if graph is None else graph
    return pipeline.step(graph, *seen, catalogue(), CONFIG, with_adjuster)


def camera_errors(result: StepResult) -> list[float]:
    """Of the static cameras, millimetres."""
    poses = [result.camera(name).world_from_camera for name in NAMES[1:]]
    return [
        1e3 * float(np.linalg.norm(pose[:3, 3] - true[:3, 3]))
        for pose, true in zip(poses, cameras()[1:], strict=True)
        if pose is not None
    ]


def object_errors(result: StepResult) -> list[float]:
    """Of the boxes, millimetres."""
    found = {o.obj_id: o.world_from_object for o in result.objects}
    return [1e3 * float(np.linalg.norm(found[n + 1][:3, 3] - true[:3, 3])) for n, true in enumerate(objects())]


def test_cameras_and_objects_move_to_where_depth_and_contours_show_them():
    before, after, objects_before, objects_after = [], [], [], []
    for seed in range(4):
        _, result = entered(moment(np.random.default_rng(seed)), with_adjuster=adjuster())
        assert result.adjustment is not None
        assert result.adjustment.energy[1] < result.adjustment.energy[0]
        before += camera_errors(result.unadjusted)
        after += camera_errors(result)
        objects_before += object_errors(result.unadjusted)
        objects_after += object_errors(result)
    assert np.median(after) < np.median(before) / 2
    assert np.median(objects_after) < np.median(objects_before) / 2


def test_the_step_before_adjustment_is_the_step_without_it():
    seen = moment(np.random.default_rng(0))
    _, plain = entered(seen)
    _, adjusted = entered(seen, with_adjuster=adjuster())
    assert camera_errors(adjusted.unadjusted) == camera_errors(plain)
    assert plain.adjustment is None and plain.unadjusted is plain


def test_stated_uncertainties_shrink_and_still_cover_the_error():
    inside = []
    for seed in range(6):
        _, result = entered(moment(np.random.default_rng(seed)), with_adjuster=adjuster())
        for name, true in zip(NAMES[1:], cameras()[1:], strict=True):
            fresh, old = result.camera(name), result.unadjusted.camera(name)
            assert np.trace(fresh.covariance[3:, 3:]) < np.trace(old.covariance[3:, 3:])
            shift = se3.minus(true, fresh.world_from_camera)
            inside.append(shift @ np.linalg.solve(fresh.covariance, shift) < 12.6)
    assert np.mean(inside) > 0.8


def test_only_new_views_are_adjusted():
    rng, tool = np.random.default_rng(0), adjuster()
    graph, first = entered(moment(rng), with_adjuster=tool)
    graph, same = entered(moment(rng, 1), graph, tool)
    moved = cameras().copy()
    moved[0] = moved[0] @ se3.exp(np.array([0, 0.1, 0, -0.1, 0, 0.05]))
    _, elsewhere = entered(moment(rng, 2, at=moved), graph, tool)
    assert first.adjustment is not None and elsewhere.adjustment is not None
    assert same.adjustment is None
    assert same.seconds["bundle"] == 0 < first.seconds["bundle"]


def test_what_was_gained_stays_in_later_steps():
    gained = []
    for seed in range(4):
        errors = []
        for tool in (None, adjuster()):
            rng = np.random.default_rng(seed)
            graph, _ = entered(moment(rng), with_adjuster=tool)
            for number in (1, 2):
                graph, result = entered(moment(rng, number), graph, tool)
            errors.append(np.mean(camera_errors(result)))
        gained.append(errors[1] / errors[0])
    assert np.median(gained) < 0.6


def test_without_depth_nothing_is_adjusted_unless_asked_for():
    seen = moment(np.random.default_rng(0), depth=False)
    _, left = entered(seen, with_adjuster=adjuster())
    _, asked = entered(seen, with_adjuster=adjuster(without_depth=True))
    assert left.adjustment is None and asked.adjustment is not None


def test_one_camera_with_depth_is_enough():
    frame_set, found = moment(np.random.default_rng(1))
    frames = (*(replace(frame, depth=None) for frame in frame_set.frames[:2]), frame_set.frames[2])
    _, result = entered((replace(frame_set, frames=frames), found), with_adjuster=adjuster())
    assert result.adjustment is not None
    assert np.mean(camera_errors(result)) < np.mean(camera_errors(result.unadjusted))


def test_a_headset_alone_refines_what_it_sees():
    frame_set, found = moment(np.random.default_rng(2))
    alone = replace(frame_set, frames=frame_set.frames[:1])
    _, result = entered((alone, found[:1]), with_adjuster=adjuster())
    graph, _ = entered((alone, found[:1]), with_adjuster=adjuster())
    assert result.adjustment is not None
    errors = [
        np.linalg.norm(rest.world_from_object[:3, 3] - objects()[rest.obj_id - 1, :3, 3])
        for rest in graph.rests.values()
    ]
    assert 1e3 * max(errors) < 4


def test_objects_of_one_class_are_told_apart():
    frame_set, found = moment(np.random.default_rng(5))
    alike = [tuple(replace(each, obj_id=1) for each in estimates) for estimates in found]
    _, result = entered((frame_set, alike), with_adjuster=adjuster())
    assert result.adjustment is not None and not result.adjustment.kept
    assert np.mean(camera_errors(result)) < np.mean(camera_errors(result.unadjusted))
    places = np.array([o.world_from_object[:3, 3] for o in result.objects])
    away = np.linalg.norm(objects()[:, None, :3, 3] - places, axis=2)
    assert 1e3 * away.min(axis=1).max() < 4


def test_an_estimate_of_another_class_at_the_same_place_is_left_alone():
    frame_set, found = moment(np.random.default_rng(6))
    agreed = objects()[0].copy()
    agreed[:3, 3] = np.mean([(w @ e[0].camera_from_object)[:3, 3] for w, e in zip(cameras(), found, strict=True)], 0)
    false = replace(found[0][0], obj_id=2, camera_from_object=se3.inverse(cameras()[0]) @ agreed)
    _, result = entered((frame_set, [(*found[0], false), *found[1:]]), with_adjuster=adjuster())
    assert result.adjustment is not None
    assert np.mean(camera_errors(result)) < np.mean(camera_errors(result.unadjusted))


def test_a_camera_that_sees_nothing_now_takes_no_part():
    rng, tool = np.random.default_rng(7), adjuster()
    graph, _ = entered(moment(rng), with_adjuster=tool)
    moved = cameras().copy()
    moved[0] = moved[0] @ se3.exp(np.array([0, 0.1, 0, -0.1, 0, 0.05]))
    frame_set, found = moment(rng, 1, at=moved)
    _, result = entered((frame_set, [*found[:2], ()]), graph, tool)
    assert result.adjustment is not None
    assert result.camera("right").status == "kept"


def test_an_object_that_the_pictures_do_not_show_keeps_its_pose_and_says_why():
    """Box 3 is estimated where there is only wall; without depth at that place nothing confirms it."""
    frame_set, found = moment(np.random.default_rng(3))
    away = se3.inverse(cameras()) @ se3.exp(np.array([0, 0, 0, 0.0, -0.25, 0.1]))
    ghosts = [(*each[:2], replace(each[2], camera_from_object=pose)) for each, pose in zip(found, away, strict=True)]
    _, result = entered((frame_set, ghosts), with_adjuster=adjuster())
    ghost = next(o for o in result.objects if o.obj_id == 3)
    was = next(o for o in result.unadjusted.objects if o.obj_id == 3)
    assert result.adjustment is not None
    assert result.adjustment.kept.get(f"object {ghost.instance}", "")
    assert np.linalg.norm(ghost.world_from_object[:3, 3] - was.world_from_object[:3, 3]) < 0.01


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_the_order_of_estimates_changes_nothing(order: Sequence[int]):
    frame_set, found = moment(np.random.default_rng(4))
    shuffled = [tuple(each[n] for n in order) for each in found]
    _, one = entered((frame_set, found), with_adjuster=adjuster())
    _, other = entered((frame_set, shuffled), with_adjuster=adjuster())
    assert camera_errors(other) == pytest.approx(camera_errors(one), abs=1e-6)


def test_a_real_lens_is_undone_in_colour_and_depth():
    camera = Camera(CAMERA.matrix, CAMERA.width, CAMERA.height, (-0.3, 0.1, 0.001, -0.002))
    points = np.array([[-0.1, -0.12, 0.5], [0.16, 0.1, 0.5], [0.02, 0.05, 0.5]])
    image = np.zeros((camera.height, camera.width, 3), np.uint8)
    depth = np.zeros(image.shape[:2], np.float32)
    for n, (u, v) in enumerate(np.rint(camera.project(points)).astype(int)):
        image[v - 2 : v + 3, u - 2 : u + 3], depth[v - 2 : v + 3, u - 2 : u + 3] = 250, 0.5 + n
    made = ideal_picture(Frame("left", 0, image, camera, None, depth))
    assert not made.camera.distortion and made.depth is not None
    for n, (u, v) in enumerate(np.rint(made.camera.project(points)).astype(int)):
        assert made.image[v, u, 0] > 200 and made.depth.depth[v, u] == 0.5 + n
    # A depth between two surfaces would be a point in the air.
    assert set(np.unique(made.depth.depth)) == {0, 0.5, 1.5, 2.5}


def test_an_ideal_lens_is_left_alone():
    frame_set, _ = moment(np.random.default_rng(0))
    made = ideal_picture(frame_set.frames[0])
    assert made.image is frame_set.frames[0].image and made.depth is not None
    assert made.depth.depth is frame_set.frames[0].depth
