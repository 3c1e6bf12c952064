"""Measured points against the surface: exact gradients, a case worked by hand, and depth that is not there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from multicam.bundle.depth.compiled import PAIR
from multicam.bundle.depth.config import DepthConfig
from multicam.bundle.depth.factor import DepthFactor
from multicam.bundle.depth.points import find_points
from multicam.bundle.depth_image import DepthImage, draw_bodies
from multicam.bundle.occlusion import Occluders, OcclusionConfig
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from tests.bundle.box_world import (
    COLOR_CAMERA,
    DEPTH_CAMERA,
    DEPTH_FROM_CAMERA,
    box,
    box_model,
    constant_depth,
    depth_picture,
    pose,
)
from tests.bundle.test_factors import assert_close, numeric_gradient, numeric_hessian
from tests.strategies import seeds, twists

CONFIG = DepthConfig()
NOTHING_HIDES = Occluders()
ONE = np.zeros(1, dtype=np.int64)


def found(image: DepthImage, at: np.ndarray, search: int = 0, occluders: Occluders = NOTHING_HIDES) -> np.ndarray:
    return find_points(box_model(), image, at, occluders, search, CONFIG)


def factor(pairs: np.ndarray) -> DepthFactor:
    return DepthFactor.of_edges(ONE, ONE, [pairs])


def random_pairs(rng: np.random.Generator, count: int, error: float) -> np.ndarray:
    pairs = np.empty(count, PAIR)
    pairs["point"] = rng.uniform(-0.05, 0.05, size=(count, 3))
    normal = rng.normal(size=(count, 3))
    pairs["normal"] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    pairs["measured"] = se3.act(pose(), pairs["point"]) + rng.normal(scale=error, size=(count, 3))
    pairs["weight"] = rng.uniform(20, 100, size=count)
    return pairs


@given(seeds(), twists(most=0.5, reach=0.05))
def test_the_gradient_is_exact_on_either_side(rng: np.random.Generator, difference: np.ndarray) -> None:
    depth = factor(random_pairs(rng, 15, error=0.01))
    at = se3.plus(pose(), difference)[None]
    gradient = depth.linearize(at).gradient[0]
    assert_close(gradient, numeric_gradient(depth.linearize, at))
    # exp(xi) T = T exp(Ad(T^-1) xi).
    steps = 1e-6 * np.eye(6)
    on_the_left = [
        (depth.linearize(se3.exp(s) @ at).energy[0] - depth.linearize(se3.exp(-s) @ at).energy[0]) / 2e-6 for s in steps
    ]
    assert_close(se3.adjoint(se3.inverse(at[0])).T @ gradient, np.array(on_the_left))


@given(seeds())
def test_the_hessian_is_exact_where_the_points_lie_on_the_surface(rng: np.random.Generator) -> None:
    depth = factor(random_pairs(rng, 15, error=0.0))
    assert depth.linearize(pose()[None]).energy[0] == pytest.approx(0, abs=1e-12)
    assert_close(depth.linearize(pose()[None]).hessian[0], numeric_hessian(depth.linearize, pose()[None]))


@given(seeds(), twists(most=0.05, reach=0.005))
def test_the_energy_falls_along_the_step(rng: np.random.Generator, difference: np.ndarray) -> None:
    depth = factor(random_pairs(rng, 15, error=0.003))
    start = se3.plus(pose(), difference)
    here = depth.linearize(start[None])
    step = np.linalg.solve(here.hessian[0] + np.diag([1.0] * 3 + [10.0] * 3), -here.gradient[0])
    assert depth.linearize(se3.plus(start, step)[None]).energy[0] < here.energy[0]


def test_the_energy_of_one_point_is_the_one_worked_out_by_hand() -> None:
    pairs = np.empty(1, PAIR)
    pairs["point"], pairs["normal"] = [0.01, 0.02, -0.03], [0, 0, -1]
    # 6 mm before the surface, and 4 mm beside, which does not count; the deviation is 0.03 times 0.5 m.
    pairs["measured"], pairs["weight"] = [0.014, 0.02, 0.464], 1 / (0.03 * 0.5)
    at = np.eye(4)
    at[2, 3] = 0.5
    answer = factor(pairs).linearize(at[None])
    assert answer.energy[0] == pytest.approx((0.006 / 0.015) ** 2 / 2)
    # Moving the object 6 mm towards the camera brings the point onto the surface.
    assert answer.gradient[0, 5] / answer.hessian[0, 5, 5] == pytest.approx(0.006)


def test_the_pairs_of_a_right_pose_lie_on_the_surface_as_seen_by_a_camera_of_its_own() -> None:
    pairs = found(depth_picture(pose()), pose())
    assert len(pairs) > 190
    in_object = se3.act(se3.inverse(pose()), pairs["measured"])
    height = np.abs(np.sum(pairs["normal"] * (pairs["point"] - in_object), axis=1))
    assert np.median(height) < 2e-4
    # Every sixth pixel of 2 mm is looked at.
    assert np.percentile(np.linalg.norm(pairs["point"] - in_object, axis=1), 90) < 0.012
    in_depth_camera = se3.act(DEPTH_FROM_CAMERA, pairs["measured"])
    assert pairs["weight"] == pytest.approx(1 / (CONFIG.deviation(0) * in_depth_camera[:, 2]))


def test_the_same_points_are_found_whichever_frame_carries_them() -> None:
    image = depth_picture(pose())
    alone = DepthImage(image.depth, image.camera, np.eye(4))
    beside, within = found(image, pose()), found(alone, DEPTH_FROM_CAMERA @ pose())
    assert len(beside) == len(within)
    assert beside["measured"] == pytest.approx(se3.act(se3.inverse(DEPTH_FROM_CAMERA), within["measured"]))


def test_no_pair_is_farther_apart_than_the_radius_of_its_search() -> None:
    moved = se3.plus(pose(), np.array([0, 0, 0, 0, 0, 0.015]))
    image = depth_picture(moved)
    for search, radius in enumerate(CONFIG.radii):
        pairs = found(image, pose(), search)
        apart = np.linalg.norm(pairs["measured"] - se3.act(pose(), pairs["point"]), axis=1)
        assert len(pairs) > 0 and apart.max() < radius


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, -1.0, 5.0])
def test_depth_that_is_unknown_or_elsewhere_gives_no_pairs(value: float) -> None:
    image = DepthImage(np.full((240, 320), value, dtype=np.float32), DEPTH_CAMERA, DEPTH_FROM_CAMERA)
    pairs = found(image, pose())
    assert len(pairs) == 0
    answer = factor(pairs).linearize(pose()[None])
    assert answer.energy[0] == 0 and not np.any(answer.gradient) and not np.any(answer.hessian)


def test_holes_in_the_depth_are_passed_over(rng: np.random.Generator) -> None:
    image = depth_picture(pose())
    holed = image.depth.copy()
    holed[rng.random(holed.shape) < 0.5] = np.nan
    pairs = found(DepthImage(holed, DEPTH_CAMERA, DEPTH_FROM_CAMERA), pose())
    assert len(pairs) > 150 and np.all(np.isfinite(pairs["measured"]))


@pytest.mark.parametrize("place", [[5.0, 0, 0.6], [0, 0, -0.6], [0, 0, 0.0]])
def test_an_object_out_of_sight_has_no_pairs(place: list[float]) -> None:
    gone = pose()
    gone[:3, 3] = place
    assert len(found(depth_picture(pose()), gone)) == 0


def visible(image: DepthImage) -> np.ndarray:
    model = box_model()
    return Occluders((image,)).visible(model.surface_point[0], model.surface_offset[0], model.offset_step, pose())


def test_an_object_hides_itself_from_nobody() -> None:
    assert visible(draw_bodies([(box(), pose())], COLOR_CAMERA)).all()
    assert visible(depth_picture(pose())).all()


@pytest.mark.parametrize(("depth", "seen"), [(0.3, False), (2.0, True), (0.0, True), (np.nan, True)])
def test_what_stands_nearer_hides_and_what_is_unknown_does_not(depth: float, seen: bool) -> None:
    assert np.all(visible(constant_depth(depth)) == seen)


def test_a_body_before_half_the_object_hides_that_half() -> None:
    before = pose()
    before[:3, 3] = 0.6 * before[:3, 3] + [0.06, 0, 0]
    seen = visible(draw_bodies([(box(), pose()), (box(), before)], COLOR_CAMERA))
    points = se3.act(pose(), box_model().surface_point[0].astype(float))
    pixels = COLOR_CAMERA.project(points)
    left_of_it = COLOR_CAMERA.project(se3.act(before, box().vertices))[:, 0].min() - 0.01 * 600 / 0.55 - 5
    assert 20 < seen.sum() < 180
    assert seen[pixels[:, 0] < left_of_it].all()


@pytest.mark.parametrize("threshold", [0.03, 0.005])
def test_an_occluder_counts_beyond_the_threshold_and_the_object_s_own_relief(threshold: float) -> None:
    model = box_model()
    depth = se3.act(pose(), model.surface_point[0].astype(float))[:, 2]
    image = constant_depth(depth.min())
    occluders = Occluders((image,), OcclusionConfig(threshold=threshold))
    seen = occluders.visible(model.surface_point[0], model.surface_offset[0], model.offset_step, pose())
    # Five steps of 2 mm are the radius of 1 cm.
    expected = depth - model.surface_offset[0, :, 5] - threshold <= image.depth[0, 0]
    assert np.array_equal(seen, expected)
    assert 0 < seen.sum() < len(seen)


def test_pictures_of_any_memory_hide_alike() -> None:
    read_only, strided = constant_depth(0.3), constant_depth(2.0)
    read_only.depth.flags.writeable = False
    strided = replace(strided, depth=np.asfortranarray(strided.depth), depth_from_camera=np.eye(4, order="F"))
    model = box_model()
    for images in ((read_only, strided), (strided, read_only)):
        args = model.surface_point[0], model.surface_offset[0], model.offset_step, pose()
        assert not Occluders(images).visible(*args).any()
        assert Occluders((strided,)).visible(*args).all()


def test_a_depth_picture_must_fit_its_camera() -> None:
    with pytest.raises(ValueError, match=r"float32 \(240, 320\)"):
        DepthImage(np.zeros((240, 321), np.float32), DEPTH_CAMERA, np.eye(4))
    with pytest.raises(ValueError, match="undistort"):
        DepthImage(np.zeros((2, 2), np.float32), Camera(np.eye(3), 2, 2, (0.1, 0.0, 0.0, 0.0)), np.eye(4))
