from __future__ import annotations

from dataclasses import replace

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.geometry import se3
from multicam.matching.arrays import BoolArray
from multicam.matching.hypotheses import measure, propose
from multicam.matching.noise import NoiseConfig
from multicam.matching.observations import PosedObjects, observe
from multicam.matching.symmetry import SymmetryTable
from tests.toy_objects import BRACKET, PEG, PLATE, PYRAMID, ROD, random_symmetry, toy_catalogue
from tests.toy_world import ToyWorld, make_world


def between_views(found: PosedObjects) -> BoolArray:
    return found.frame[:, None] < found.frame[None, :]


def prepared(world: ToyWorld, rng: np.random.Generator):
    found = observe(world.views(rng), world.catalogue, NoiseConfig())
    return found, *matched(found, world.catalogue)


def matched(found: PosedObjects, catalogue: Catalogue):
    symmetries = SymmetryTable.of(catalogue)
    measured = measure(found, found, between_views(found), symmetries)
    return measured, propose(measured, found, found, symmetries)


def errors(world: ToyWorld, frames: np.ndarray, poses: np.ndarray) -> np.ndarray:
    cameras = np.array([camera.world_from_camera for camera in world.cameras])
    truth = se3.inverse(cameras[frames[:, 0]]) @ cameras[frames[:, 1]]
    return np.abs(poses - truth).max(axis=(1, 2))


def test_every_pair_of_views_and_class_is_measured_with_every_discrete_symmetry(rng: np.random.Generator) -> None:
    world = make_world(rng, num_cameras=3, classes=(BRACKET, PLATE, BRACKET))
    found, measured, _ = prepared(world, rng)
    # Three links, each with 2 x 2 brackets and one plate of four attitudes.
    assert measured.frames.tolist() == [[0, 1], [0, 2], [1, 2]]
    assert np.bincount(measured.link).tolist() == [8, 8, 8]
    assert np.all(np.diff(measured.link) >= 0)
    assert np.all(found.obj_id[measured.reference] == found.obj_id[measured.query])


def test_one_symmetric_variant_of_each_true_pair_measures_the_truth(rng: np.random.Generator) -> None:
    world = make_world(rng, classes=(BRACKET, PLATE))
    _, measured, _ = prepared(world, rng)
    error = errors(world, measured.frames[measured.link], measured.pose)
    assert np.count_nonzero(error < 1e-9) == 2 * 3


def test_a_second_object_tells_the_turn_about_an_axis(rng: np.random.Generator) -> None:
    world = make_world(rng, num_cameras=2, classes=(PEG, ROD))
    _, measured, hypotheses = prepared(world, rng)
    error = errors(world, measured.frames[hypotheses.link], hypotheses.pose)
    # The peg with the rod's centre, and one attitude of the rod with the peg's.
    assert np.count_nonzero(error < 1e-9) == 2


def test_an_axis_without_a_second_object_still_gives_a_hypothesis(rng: np.random.Generator) -> None:
    _, measured, hypotheses = prepared(make_world(rng, num_cameras=2, classes=(PEG,)), rng)
    assert len(hypotheses) == len(measured) == 1
    assert np.sqrt(np.trace(hypotheses.covariance[0, :3, :3])) > 1


def test_the_covariance_of_a_measurement_agrees_with_sampling(rng: np.random.Generator) -> None:
    catalogue: Catalogue = toy_catalogue()
    poses = np.stack([se3.exp(np.array([0.4, -0.3, 0.9, 0.1, 0, 0.8])), se3.exp(np.array([-1.0, 0.5, 0.2, 0, 0.2, 1]))])
    spread = np.stack([np.diag([2, 5, 3, 1, 2, 1]), np.diag([3, 1, 4, 2, 1, 3])]) * 1e-3
    objects = PosedObjects(np.array([0, 1]), np.array([PYRAMID] * 2), np.ones(2), poses, spread**2)
    symmetries = SymmetryTable.of(catalogue)
    measured = measure(objects, objects, between_views(objects), symmetries)
    moved = se3.plus(poses, rng.normal(size=(20_000, 2, 6)) * np.diagonal(spread, axis1=1, axis2=2))
    start = symmetries.start[symmetries.rows(np.array([PYRAMID]))[0]]
    for row in range(len(measured)):
        symmetry = symmetries.transforms[start + measured.variant[row]]
        samples = moved[:, 0] @ symmetry @ se3.inverse(moved[:, 1])
        deviation = se3.minus(samples, measured.pose[row])
        assert np.allclose(np.cov(deviation.T), measured.covariance[row], atol=0.03 * measured.covariance[row].max())


def test_a_twin_of_an_estimate_changes_no_set_of_measurements(rng: np.random.Generator) -> None:
    world = make_world(rng, num_cameras=2, classes=(PLATE,))
    found, measured, _ = prepared(world, rng)
    symmetry = random_symmetry(world.catalogue[PLATE].symmetries, rng)
    twins = found.frame_from_object.copy()
    twins[1] = twins[1] @ symmetry
    again, _ = matched(replace(found, frame_from_object=twins), world.catalogue)
    distance = np.abs(measured.pose[:, None] - again.pose[None]).max(axis=(2, 3))
    assert np.allclose(distance.min(axis=0), 0, atol=1e-9)
    assert np.allclose(distance.min(axis=1), 0, atol=1e-9)


def test_rivals_and_doubtful_scores_lower_the_prior(rng: np.random.Generator) -> None:
    catalogue = toy_catalogue()
    frame, classes = np.array([0, 0, 0, 1]), np.array([BRACKET, BRACKET, PLATE, BRACKET])
    objects = PosedObjects(
        frame, classes, np.array([0.9, 0.5, 0.9, 0.8]), se3.random(rng, 4), np.array([np.eye(6)] * 4)
    )
    measured, _ = matched(objects, catalogue)
    assert np.allclose(np.exp(measured.log_prior), [0.9 * 0.8 / 2, 0.5 * 0.8 / 2])


def test_nothing_in_common_gives_nothing(rng: np.random.Generator) -> None:
    world = make_world(rng, classes=(BRACKET,))
    found = observe(world.views(rng), world.catalogue, NoiseConfig())
    found = replace(found, frame=np.zeros(3, dtype=np.int64))
    measured, hypotheses = matched(found, world.catalogue)
    assert len(measured) == len(measured.frames) == len(hypotheses) == 0
