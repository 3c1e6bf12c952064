from __future__ import annotations

from dataclasses import replace

import numpy as np

from multicam.geometry import se3
from multicam.matching.assignment import Tracks, associate
from multicam.matching.likelihood import LikelihoodConfig
from multicam.matching.noise import NoiseConfig
from multicam.matching.observations import observe
from multicam.matching.symmetry import SymmetryTable
from multicam.types import View
from tests.toy_objects import BRACKET, PEG, PLATE, ROD
from tests.toy_world import ToyWorld, make_world


def tracks_of(world: ToyWorld, views: tuple[View, ...], order: tuple[int, ...] = (0, 1, 2)) -> Tracks:
    """Association with the true camera poses."""
    found = observe(views, world.catalogue, NoiseConfig())
    cameras = np.array([camera.world_from_camera for camera in world.cameras])[list(order)]
    symmetries = SymmetryTable.of(world.catalogue)
    spread = np.zeros((len(order), 6, 6))
    return associate(found, np.array(order), cameras, spread, symmetries, LikelihoodConfig())


def true_identity(world: ToyWorld, tracks: Tracks) -> np.ndarray:
    """Which true object each fused object is, by distance."""
    truth = np.array([toy.world_from_object[:3, 3] for toy in world.objects])
    fused = tracks.fused.frame_from_object[:, :3, 3]
    return np.argmin(np.linalg.norm(fused[:, None] - truth[None], axis=-1), axis=1)


def test_each_object_is_one_track_over_all_views(rng: np.random.Generator) -> None:
    world = make_world(rng, classes=(BRACKET, BRACKET, PLATE, ROD, PEG, BRACKET))
    tracks = tracks_of(world, world.views(rng, rotation_noise=0.01, translation_noise=0.002))
    assert np.bincount(tracks.object).tolist() == [3] * 6
    assert sorted(true_identity(world, tracks)) == [0, 1, 2, 3, 4, 5]


def test_twins_are_turned_to_the_first_sighting(rng: np.random.Generator) -> None:
    world = make_world(rng, classes=(PLATE, ROD, PEG))
    views = world.views(rng)
    tracks = tracks_of(world, views)
    cameras = np.array([camera.world_from_camera for camera in world.cameras])
    frame = observe(views, world.catalogue, NoiseConfig()).frame[tracks.estimate]
    in_world = cameras[frame] @ tracks.camera_from_object
    assert np.allclose(in_world, tracks.fused.frame_from_object[tracks.object], atol=1e-9)


def test_a_view_gives_each_object_one_estimate_at_most(rng: np.random.Generator) -> None:
    world = make_world(rng, classes=(BRACKET, PLATE))
    views = world.views(rng)
    twice = replace(views[1], estimates=views[1].estimates * 2)
    tracks = tracks_of(world, (views[0], twice, views[2]))
    frame = observe((views[0], twice, views[2]), world.catalogue, NoiseConfig()).frame[tracks.estimate]
    assert len(np.unique(np.stack((tracks.object, frame)), axis=1).T) == len(tracks.object)
    assert np.sort(np.bincount(tracks.object)).tolist() == [1, 1, 3, 3]


def test_a_displaced_object_is_another_one(rng: np.random.Generator) -> None:
    world = make_world(rng, classes=(BRACKET,))
    views = world.views(rng)
    estimate = views[1].estimates[0]
    away = replace(estimate, camera_from_object=estimate.camera_from_object @ se3.exp(np.array([0, 0, 0, 0.1, 0, 0])))
    tracks = tracks_of(world, (views[0], replace(views[1], estimates=(away,)), views[2]))
    assert tracks.object.tolist() == [0, 1, 0]


def test_fusing_sharpens_and_scores_add_up(rng: np.random.Generator) -> None:
    world = make_world(rng, classes=(BRACKET,))
    views = world.views(rng, rotation_noise=0.01, translation_noise=0.002)
    tracks = tracks_of(world, views)
    assert np.all(np.diag(tracks.fused.covariance[0]) < 0.4 * np.diag(tracks.covariance[0]))
    scores = [view.estimates[0].score for view in views]
    assert np.isclose(tracks.fused.score[0], 1 - np.prod([1 - min(s, 0.98) for s in scores]))


def test_identities_do_not_depend_on_the_order_of_cameras(rng: np.random.Generator) -> None:
    world = make_world(rng, classes=(BRACKET, BRACKET, PLATE))
    views = world.views(rng, rotation_noise=0.005, translation_noise=0.001)
    one, other = tracks_of(world, views), tracks_of(world, views, (2, 0, 1))
    for tracks in (one, other):
        tracks.object[:] = true_identity(world, tracks)[tracks.object]
    assert np.array_equal(one.object[np.argsort(one.estimate)], other.object[np.argsort(other.estimate)])
    assert one.same_identities(one)
    assert not one.same_identities(other)
