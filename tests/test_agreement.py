"""Noise learnt from agreement alone, in a world where its truth is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from multicam.geometry import se3
from multicam.matching.learned import NoiseModel, centre_in_camera, viewing_axes
from multicam.matching.noise import NoiseConfig, geometric_covariance
from multicam.registration import LearningConfig, RegistrationConfig, learn_noise, register_views
from multicam.registration.halves import variance_ratio
from multicam.registration.kinship import count_alike, inflation
from multicam.types import Component, ObjectEstimate, View
from tests.close import assert_close
from tests.toy_objects import BRACKET, PLATE, PYRAMID, WEDGE
from tests.toy_world import ToyWorld, camera_error, looking_at, make_world

CLASSES = (BRACKET, PLATE, PYRAMID, WEDGE)
CONFIG, LEARNING = RegistrationConfig(), LearningConfig(rounds=4, groups=20)

Factors = Callable[[int], tuple[float, float, float]]
"""obj_id to the true factors of attitude, lateral and depth."""


def plain(obj_id: int) -> tuple[float, float, float]:
    return 1.0, 1.0, 1.0


def estimates_without_covariance(
    world: ToyWorld, rng: np.random.Generator, factors: Factors, too_far: float = 0.0, alike: int = 0
) -> tuple[View, ...]:
    """Noise as large as the geometric model says, times factors; the first `alike` cameras share their errors."""
    shared = rng.normal(size=(len(world.objects), 6))
    views: list[View] = []
    for number, camera in enumerate(world.cameras):
        estimates: list[ObjectEstimate] = []
        for index in camera.visible:
            model = world.catalogue[world.objects[index].obj_id]
            truth = (se3.inverse(camera.world_from_camera) @ world.objects[index].world_from_object)[None]
            corners = model.box_corners()
            focal = np.array([camera.camera.matrix[0, 0]])
            covariance = geometric_covariance(truth, corners[None], focal, NoiseConfig())[0]
            centre = corners.mean(axis=0)[None]
            axes = viewing_axes(truth, centre)[0]
            scale = np.repeat(factors(model.obj_id), (3, 2, 1))
            draw = shared[index] if number < alike else rng.normal(size=6)
            deviation = scale * (np.linalg.cholesky(axes @ covariance @ axes.T) @ draw)
            pose = se3.plus(truth[0], np.linalg.solve(axes, deviation))
            if model.obj_id == WEDGE:
                pose[:3, 3] += np.expm1(too_far) * centre_in_camera(pose[None], centre)[0]
            estimates.append(ObjectEstimate(model.obj_id, 0.9, pose))
        views.append(View(camera.camera_id, tuple(estimates), camera.camera.matrix))
    return tuple(views)


def learnt(rng: np.random.Generator, factors: Factors = plain, too_far: float = 0.0, groups: int = 20) -> NoiseModel:
    worlds = [make_world(rng, 4, CLASSES) for _ in range(groups)]
    views = [estimates_without_covariance(world, rng, factors, too_far) for world in worlds]
    return learn_noise(views, worlds[0].catalogue, CONFIG, LearningConfig(groups=groups))


def test_noise_that_is_as_stated_stays_about_the_same(rng: np.random.Generator) -> None:
    model = learnt(rng)
    for obj_id in CLASSES:
        noise = model.of(obj_id)
        assert 0.7 < noise.attitude < 1.4
        assert 0.7 < noise.lateral < 1.4
        assert 0.7 < noise.depth < 1.4
        assert abs(noise.too_far) < 0.01
    assert model.kinship < 1.5


def test_a_class_that_is_noisier_in_one_direction_is_found_out(rng: np.random.Generator) -> None:
    model = learnt(rng, lambda obj_id: (3.0, 1.0, 1.0) if obj_id == PLATE else (1.0, 1.0, 1.0))
    assert 1.7 < model.of(PLATE).attitude < 4.0
    assert 0.5 < model.of(PLATE).lateral < 1.5
    assert model.of(PLATE).attitude > 1.5 * max(model.of(obj_id).attitude for obj_id in CLASSES if obj_id != PLATE)


def test_a_depth_that_is_always_too_far_is_found_out(rng: np.random.Generator) -> None:
    model = learnt(rng, too_far=0.06)
    assert model.of(WEDGE).too_far == pytest.approx(0.06, abs=0.02)
    assert all(abs(model.of(obj_id).too_far) < 0.02 for obj_id in CLASSES if obj_id != WEDGE)


def test_errors_shared_by_like_views_are_stated_larger(rng: np.random.Generator) -> None:
    def kinship(alike: int) -> float:
        worlds = [make_world(rng, 7, CLASSES) for _ in range(16)]
        # The first cameras stand 20 degrees apart; of the others, every second is left out.
        kept = [ToyWorld(w.catalogue, (*w.cameras[:3], w.cameras[6]), w.objects) for w in worlds]
        groups = [estimates_without_covariance(world, rng, plain, alike=alike) for world in kept]
        return learn_noise(groups, kept[0].catalogue, CONFIG, LEARNING).kinship

    assert kinship(3) > 1.3 * kinship(0)


def test_more_cameras_are_placed_and_better_with_learnt_noise(rng: np.random.Generator) -> None:
    def factors(obj_id: int) -> tuple[float, float, float]:
        return (4.0, 3.0, 1.0) if obj_id in (PLATE, WEDGE) else (0.5, 0.5, 1.0)

    model = learnt(rng, factors, groups=24)
    errors: list[list[float]] = []
    for _ in range(24):
        world = make_world(rng, 4, CLASSES)
        views = estimates_without_covariance(world, rng, factors)
        answers = [register_views(views, world.catalogue, CONFIG, noise) for noise in (None, model)]
        errors.append([greatest_error(world, answer.components) for answer in answers])
    found = np.array(errors)
    plain_count, learnt_count = np.isfinite(found).sum(axis=0)
    assert learnt_count > plain_count
    both = np.all(np.isfinite(found), axis=1)
    assert both.sum() >= 5
    assert np.mean(found[both, 1]) < 0.97 * np.mean(found[both, 0])


def greatest_error(world: ToyWorld, components: tuple[Component, ...]) -> float:
    """Metres, over all pairs of cameras; infinite if one is not placed with the others."""
    if len(components) != 1 or len(components[0].cameras) < len(world.cameras):
        return np.inf
    return camera_error(world.world_from_camera, components[0])[1]


@pytest.mark.parametrize("size", [0.7, 1.5])
def test_error_bars_are_calibrated_with_learnt_noise(rng: np.random.Generator, size: float) -> None:
    """Whether the noise is smaller or larger than stated, about 95 % of the truth lies in the 95 % ellipsoids."""
    worlds = [make_world(rng, 4) for _ in range(40)]
    groups = [estimates_without_covariance(world, rng, lambda _: (size, size, size)) for world in worlds]
    model = learn_noise(groups, worlds[0].catalogue, CONFIG, LearningConfig(rounds=4, groups=20))
    inside: list[bool] = []
    for world, views in zip(worlds, groups, strict=True):
        for component in register_views(views, world.catalogue, CONFIG, model).components:
            first, *others = component.cameras
            origin = world.world_from_camera[first.view_id]
            for camera in others:
                truth = se3.inverse(origin) @ world.world_from_camera[camera.view_id]
                error = se3.minus(truth, camera.world_from_camera)
                inside.append(bool(error @ np.linalg.solve(camera.covariance, error) < 12.59))
    assert len(inside) > 100
    # As stated, 73 and 99.6 % lie inside.
    assert 0.82 < np.mean(inside) < 0.99


def test_halves_that_disagree_more_than_stated_tell_by_how_much(rng: np.random.Generator) -> None:
    assert variance_ratio(np.zeros(0)) == pytest.approx(1, abs=0.05)
    assert variance_ratio(3 * rng.chisquare(6, 4000)) == pytest.approx(3, rel=0.1)


def test_like_views_count_as_fewer() -> None:
    alone, together = inflation(2.0, np.array([1])), inflation(2.0, np.array([4]))
    assert alone[0] == pytest.approx(2)
    # Half of their variance is common: four are worth 4 / (1 + 3 / 2) = 1.6 independent ones.
    assert together[0] == pytest.approx(2 * 4 / 1.6)
    assert_close(inflation(1.0, np.arange(1, 9)), np.ones(8), atol=0)


def test_like_directions_are_counted_per_object() -> None:
    azimuth = np.radians([0.0, 20.0, 90.0, 0.0])
    eyes = np.stack((np.sin(azimuth), -np.cos(azimuth), np.zeros(4)), axis=1)
    poses = np.stack([se3.inverse(looking_at(eye, np.zeros(3))) for eye in eyes])
    assert count_alike(poses, np.zeros((4, 3)), np.array([0, 0, 0, 1])).tolist() == [2, 2, 1, 1]


def test_no_rounds_and_no_agreement_teach_nothing(rng: np.random.Generator) -> None:
    world = make_world(rng, 3, CLASSES)
    views = estimates_without_covariance(world, rng, plain)
    assert learn_noise([views], world.catalogue, CONFIG, LearningConfig(rounds=0)) == NoiseModel()
    assert learn_noise([views[:1]], world.catalogue, CONFIG, LEARNING) == NoiseModel()
