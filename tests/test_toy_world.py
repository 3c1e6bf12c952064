"""The toy world is itself exact: other tests lean on it."""

from __future__ import annotations

import numpy as np
import pytest

from multicam.geometry import se3
from multicam.geometry.mesh import Mesh
from multicam.types import Component, PlacedCamera, PlacedObject, View
from tests.close import assert_close
from tests.toy_objects import BRACKET, random_symmetry, toy_meshes, toy_symmetries
from tests.toy_walk import HEADSET, LEFT, RIGHT, make_walk
from tests.toy_world import ToyWorld, camera_error, distance_to_nearest, make_world, object_errors


@pytest.mark.parametrize("obj_id", toy_meshes())
def test_declared_symmetries_leave_the_surface_where_it_is(obj_id: int, rng: np.random.Generator) -> None:
    mesh, symmetries = toy_meshes()[obj_id], toy_symmetries()[obj_id]
    for _ in range(10):
        moved = se3.act(random_symmetry(symmetries, rng), mesh.vertices)
        # The facets of the round ones leave the circle by radius * (1 - cos(pi / 64)).
        assert outside(mesh, moved) < 5e-5


def test_meshes_face_outwards() -> None:
    for mesh in toy_meshes().values():
        corners = mesh.vertices[mesh.faces]
        volume = np.einsum("ij,ij->", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]) / 6
        assert volume > 1e-6


def test_an_exact_estimate_is_the_truth_up_to_a_symmetry(rng: np.random.Generator) -> None:
    world = make_world(rng)
    for camera, view in zip(world.cameras, world.views(rng), strict=True):
        assert len(view.estimates) == len(camera.visible) == len(world.objects)
        assert distances_to_truth(world, camera.world_from_camera, view) == pytest.approx(0, abs=1e-6)


def test_twins_noise_and_outliers_do_what_they_say(rng: np.random.Generator) -> None:
    world = make_world(rng, classes=[BRACKET] * 5)
    camera = world.cameras[0].world_from_camera
    noisy = world.views(rng, rotation_noise=0.01, translation_noise=0.002)[0]
    assert 1e-4 < distances_to_truth(world, camera, noisy).mean() < 0.01
    covariance = noisy.estimates[0].covariance
    assert covariance is not None
    assert np.diag(covariance) == pytest.approx([1e-4] * 3 + [4e-6] * 3)
    wrong = world.views(rng, outlier_fraction=1.0)[0]
    assert distances_to_truth(world, camera, wrong).min() > 0.02


def test_detections_agree_with_the_poses(rng: np.random.Generator) -> None:
    world = make_world(rng)
    for camera, view in zip(world.cameras, world.views(rng), strict=True):
        for estimate in view.estimates:
            assert estimate.detection is not None
            points = world.catalogue[estimate.obj_id].keypoints
            assert points is not None
            expected = camera.camera.project(se3.act(estimate.camera_from_object, points))
            assert_close(estimate.detection.keypoints, expected)
            assert camera.camera.contains(expected).all()
    assert all(e.detection is None for v in world.views(rng, with_detections=False) for e in v.estimates)


def test_the_ends_of_a_chain_share_no_object(rng: np.random.Generator) -> None:
    world = make_world(rng, num_cameras=4, classes=(1, 2, 3), chain=True)
    seen = [set(camera.visible) for camera in world.cameras]
    assert [len(seen[i] & seen[i + 1]) for i in range(3)] == [3, 3, 3]
    assert [seen[i] & seen[j] for i, j in ((0, 2), (0, 3), (1, 3))] == [set()] * 3


def test_error_helpers_ignore_the_gauge_and_see_a_displacement(rng: np.random.Generator) -> None:
    world = make_world(rng)
    gauge, zero = se3.random(rng), np.zeros((6, 6))
    cameras = tuple(PlacedCamera(c.camera_id, gauge @ c.world_from_camera, zero) for c in world.cameras)
    objects = tuple(
        PlacedObject(o.obj_id, 1.0, gauge @ o.world_from_object @ twin(world, o.obj_id, rng), zero)
        for o in world.objects
    )
    exact = Component(cameras, objects)
    assert camera_error(world.world_from_camera, exact) == pytest.approx((0, 0), abs=1e-7)
    assert object_errors(world, exact) == pytest.approx([0] * 6, abs=1e-9)
    shifted = se3.plus(cameras[2].world_from_camera, np.array([0, 0, 0.02, 0, 0.03, 0]))
    moved = Component((*cameras[:2], PlacedCamera("camera2", shifted, zero)), objects)
    assert camera_error(world.world_from_camera, moved)[0] == pytest.approx(0.02)
    assert camera_error(world.world_from_camera, moved)[1] >= 0.0299


def test_static_cameras_of_a_walk_never_share_an_object(rng: np.random.Generator) -> None:
    walk = make_walk(rng)
    seen: dict[str, set[int]] = {HEADSET: set(), LEFT: set(), RIGHT: set()}
    for step in walk.steps:
        for camera in step.world.cameras:
            seen[camera.camera_id] |= set(camera.visible)
    assert not seen[LEFT] & seen[RIGHT]
    assert seen[HEADSET] == seen[LEFT] | seen[RIGHT]
    assert all(walk.steps[i].world.cameras[0].visible for i in (0, -1))
    assert any(HEADSET not in [v.view_id for v in step.views(rng)] for step in walk.steps)


def test_tracking_follows_the_truth_unless_it_drifts(rng: np.random.Generator) -> None:
    for step in make_walk(rng).steps:
        assert_close(step.tracked_world_from_headset, step.world.world_from_camera[HEADSET])
    last = make_walk(rng, rotation_drift=0.002, translation_drift=0.002).steps[-1]
    assert (
        1e-3 < np.linalg.norm(se3.minus(last.tracked_world_from_headset, last.world.world_from_camera[HEADSET])) < 0.1
    )


def twin(world: ToyWorld, obj_id: int, rng: np.random.Generator) -> np.ndarray:
    return random_symmetry(world.catalogue[obj_id].symmetries, rng)


def distances_to_truth(world: ToyWorld, world_from_camera: np.ndarray, view: View) -> np.ndarray:
    """For each estimate the symmetric distance to the nearest true object of its class."""
    distances: list[float] = []
    for estimate in view.estimates:
        truths = np.stack([o.world_from_object for o in world.objects if o.obj_id == estimate.obj_id])
        pose = world_from_camera @ estimate.camera_from_object
        distances.append(distance_to_nearest(pose, truths, world.catalogue[estimate.obj_id]))
    return np.array(distances)


def outside(mesh: Mesh, points: np.ndarray) -> float:
    """Greatest distance (m) by which a point lies before a face of a convex mesh."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return float(np.einsum("pfi,fi->pf", points[:, None] - corners[:, 0], normals).max())
