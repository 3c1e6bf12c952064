from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from multicam.geometry import se3
from multicam.matching.consensus import Consensus, ConsensusConfig, find_consensus
from multicam.matching.hypotheses import measure, propose
from multicam.matching.likelihood import LikelihoodConfig
from multicam.matching.noise import NoiseConfig
from multicam.matching.observations import observe
from multicam.matching.symmetry import SymmetryTable
from multicam.types import View
from tests.toy_objects import BRACKET, PEG, PLATE, ROD, WEDGE, toy_catalogue
from tests.toy_world import ALL_CLASSES, ToyWorld, make_world


def consensus_of(views: tuple[View, ...], config: ConsensusConfig | None = None) -> Consensus:
    catalogue = toy_catalogue()
    found = observe(views, catalogue, NoiseConfig())
    symmetries = SymmetryTable.of(catalogue)
    measured = measure(found, found, found.frame[:, None] < found.frame[None, :], symmetries)
    return find_consensus(measured, propose(measured, found, found, symmetries), config or ConsensusConfig())


def position_errors(world: ToyWorld, found: Consensus) -> np.ndarray:
    cameras = np.array([camera.world_from_camera for camera in world.cameras])
    truth = se3.inverse(cameras[found.frames[:, 0]]) @ cameras[found.frames[:, 1]]
    return np.linalg.norm(found.pose[:, :3, 3] - truth[:, :3, 3], axis=1)


def test_without_noise_the_relative_poses_are_exact(rng: np.random.Generator) -> None:
    world = make_world(rng)
    found = consensus_of(world.views(rng))
    assert position_errors(world, found).max() < 1e-9
    assert found.support.tolist() == [6, 6, 6]
    assert np.all(found.log_odds > 20)


def test_the_refit_is_more_accurate_than_any_single_pair(rng: np.random.Generator) -> None:
    worlds = [make_world(rng, num_cameras=2) for _ in range(10)]
    views = [world.views(rng, rotation_noise=0.03, translation_noise=0.004, symmetric_twins=False) for world in worlds]
    refitted = [position_errors(w, consensus_of(v))[0] for w, v in zip(worlds, views, strict=True)]
    single = [
        position_errors(w, consensus_of(v, ConsensusConfig(rounds=0)))[0] for w, v in zip(worlds, views, strict=True)
    ]
    assert np.mean(refitted) < 0.75 * np.mean(single)


def test_forty_percent_of_gross_errors_do_not_mislead(rng: np.random.Generator) -> None:
    misled, believed, pairs = 0, 0, 0
    for _ in range(25):
        world = make_world(rng)
        found = consensus_of(world.views(rng, rotation_noise=0.01, translation_noise=0.002, outlier_fraction=0.4))
        right = position_errors(world, found) < 0.05
        misled += np.count_nonzero(~right & (found.log_odds > 4))
        believed += np.count_nonzero(found.log_odds > 4)
        pairs += len(right)
    assert misled == 0
    assert believed > 0.6 * pairs


def test_instances_of_one_class_are_told_apart(rng: np.random.Generator) -> None:
    world = make_world(rng, classes=(BRACKET,) * 4)
    found = consensus_of(world.views(rng, rotation_noise=0.01, translation_noise=0.002))
    assert position_errors(world, found).max() < 0.02
    assert found.support.tolist() == [4, 4, 4]


def test_an_estimate_given_twice_is_no_second_witness(rng: np.random.Generator) -> None:
    views = make_world(rng, num_cameras=2, classes=(BRACKET,)).views(rng)
    doubled = tuple(View(view.view_id, view.estimates * 2, view.camera_matrix) for view in views)
    assert consensus_of(doubled).support.tolist() == [1]
    assert consensus_of(doubled).log_odds[0] < 0


def test_a_single_pair_has_no_evidence_for_itself(rng: np.random.Generator) -> None:
    found = consensus_of(make_world(rng, num_cameras=2, classes=(BRACKET,)).views(rng))
    assert found.support.tolist() == [1]
    assert found.log_odds[0] <= found.evidence[0] < 0


def test_an_object_of_another_place_adds_no_evidence(rng: np.random.Generator) -> None:
    world = make_world(rng, num_cameras=2, classes=(BRACKET, WEDGE))
    found = consensus_of(world.views(rng, outlier_fraction=1.0))
    assert found.support.tolist() == [1]


def test_two_objects_that_share_their_axis_leave_a_turn_open(rng: np.random.Generator) -> None:
    found = consensus_of(coaxial_views(rng))
    assert found.evidence[0] > 4
    assert np.sqrt(np.trace(found.covariance[0, :3, :3])) > 0.5


def test_a_flipped_pair_leaves_two_poses(rng: np.random.Generator) -> None:
    # A brick and a rod across its middle look the same after a half turn of both.
    world = make_world(rng, num_cameras=2, classes=(PLATE,))
    views: list[View] = []
    for view in world.views(rng, symmetric_twins=False):
        plate = view.estimates[0]
        views.append(View(view.view_id, (plate, replace(plate, obj_id=ROD)), view.camera_matrix))
    found = consensus_of(tuple(views))
    assert found.rival[0] == pytest.approx(found.evidence[0], abs=0.1)
    assert found.evidence[0] > 4
    assert found.log_odds[0] < 0.1


@pytest.mark.parametrize("count", [1, 2, 3])
def test_evidence_grows_with_each_object(rng: np.random.Generator, count: int) -> None:
    few = consensus_of(make_world(rng, num_cameras=2, classes=ALL_CLASSES[:count]).views(rng))
    more = consensus_of(make_world(rng, num_cameras=2, classes=ALL_CLASSES[: count + 1]).views(rng))
    assert more.evidence[0] > few.evidence[0] + 3


def test_a_gross_error_is_clutter_and_a_small_one_is_not() -> None:
    config = LikelihoodConfig(tail=2.0, clutter_volume=0.1)
    log_determinant = 2 * np.log(np.prod([0.05, 0.05, 0.05, 0.005, 0.005, 0.02]))
    ratio = config.log_ratio(np.array([0.0, 6.0, 1e5]), log_determinant)
    assert np.all(np.diff(ratio) < 0)
    assert ratio[0] > ratio[1] > 5
    assert ratio[2] < 0


def coaxial_views(rng: np.random.Generator) -> tuple[View, ...]:
    """A peg and a rod on one line, seen by two cameras."""
    world = make_world(rng, num_cameras=2, classes=(PEG, ROD))
    views = world.views(rng, symmetric_twins=False)
    catalogue = toy_catalogue()
    shift = se3.from_parts(np.eye(3), catalogue[PEG].symmetries.axes[0].offset + np.array([0, 0, 0.2]))
    moved: list[View] = []
    for view in views:
        peg, rod = sorted(view.estimates, key=lambda estimate: estimate.obj_id)
        on_axis = replace(rod, camera_from_object=peg.camera_from_object @ shift)
        moved.append(View(view.view_id, (peg, on_axis), view.camera_matrix))
    return tuple(moved)
