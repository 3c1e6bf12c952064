import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from multicam.dataset.objects import ObjectModel
from multicam.geometry import se3, so3
from multicam.geometry.symmetry import Axis, Symmetries
from tests.strategies import seeds
from train.symmetry import allocentric, canonical_view, invariant_centre

HALF_TURN = se3.from_parts(so3.exp(np.array([0, 0, np.pi])), np.array([0.02, 0.0, 0.0]))

KINDS = {
    "none": Symmetries(),
    "half turn about a shifted axis": Symmetries(HALF_TURN[None]),
    "three turns": Symmetries(
        np.stack([se3.from_parts(so3.exp(np.array([0, 0, 2 * np.pi * k / 3])), np.zeros(3)) for k in (1, 2)])
    ),
    "round": Symmetries(axes=(Axis(np.array([0, 0, 1.0]), np.array([0.01, 0, 0])),)),
    "round and reversible": Symmetries(
        se3.from_parts(so3.exp(np.array([np.pi, 0, 0])), np.zeros(3))[None], (Axis(np.array([0, 0, 1.0])),)
    ),
}
BOX = np.array([[-0.05, -0.02, -0.01], [0.07, 0.03, 0.02]])


def model(kind: str) -> ObjectModel:
    return ObjectModel(1, kind, 0.15, KINDS[kind], BOX)


def poses_before_camera(rng: np.random.Generator, count: int) -> np.ndarray:
    place = np.stack([*rng.uniform(-0.3, 0.3, (2, count)), rng.uniform(0.4, 1.0, count)], axis=1)
    return se3.from_parts(so3.random(rng, count), place)


def any_symmetry(symmetries: Symmetries, rng: np.random.Generator) -> np.ndarray:
    group = np.concatenate((np.eye(4)[None], symmetries.discrete))
    chosen = group[rng.integers(len(group))]
    for axis in symmetries.axes:
        chosen = axis.rotation(rng.uniform(0, 2 * np.pi, 1))[0] @ chosen
    return chosen


@settings(max_examples=25)
@given(seeds(), st.sampled_from(sorted(KINDS)))
def test_equivalent_poses_get_the_same_target(rng: np.random.Generator, kind: str) -> None:
    view = canonical_view(model(kind), poses_before_camera(rng, 20))
    poses = poses_before_camera(rng, 10)
    same = np.stack([pose @ any_symmetry(KINDS[kind], rng) for pose in poses])
    assert np.allclose(view.canonical(poses), view.canonical(same), atol=1e-6)


@settings(max_examples=25)
@given(seeds(), st.sampled_from(sorted(KINDS)))
def test_the_target_shows_the_same_picture(rng: np.random.Generator, kind: str) -> None:
    view = canonical_view(model(kind), poses_before_camera(rng, 20))
    poses = poses_before_camera(rng, 5)
    between = se3.inverse(poses) @ view.canonical(poses)
    for turn in between:
        nearest = KINDS[kind].closest(turn, np.eye(4), extent=0.1)
        assert np.allclose(nearest, turn, atol=1e-6)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_the_target_does_not_depend_on_the_place_in_the_image(kind: str) -> None:
    rng = np.random.default_rng(3)
    view = canonical_view(model(kind), poses_before_camera(rng, 30))
    centre = invariant_centre(model(kind))
    for _ in range(20):
        # One and the same look, seen at several places: the camera only turns about its own centre.
        look = so3.random(rng)
        labels = []
        for ray in rng.uniform(-0.4, 0.4, (5, 2)):
            direction = np.array([*ray, 1.0]) / np.linalg.norm([*ray, 1.0])
            turned = _least_rotation(direction) @ look
            pose = se3.from_parts(turned, 0.6 * direction - turned @ centre)
            labels.append(allocentric(view.canonical(pose[None]), centre)[0])
        assert np.allclose(labels, labels[0], atol=1e-6)


def test_the_egocentric_rotation_would_change_with_the_place() -> None:
    pose = se3.from_parts(np.eye(3), np.array([0.3, 0, 0.6]))
    assert not np.allclose(allocentric(pose[None], np.zeros(3))[0], np.eye(3), atol=0.1)


def test_the_canonical_view_lies_amid_the_training_views() -> None:
    rng = np.random.default_rng(0)
    # All views within 20 degrees of one: the labels must never jump among them.
    look = so3.random(rng)
    near = look @ so3.exp(rng.uniform(-0.2, 0.2, (60, 3)))
    shuffled = np.stack([any_symmetry(KINDS["three turns"], rng)[:3, :3] for _ in near])
    poses = se3.from_parts(near @ shuffled, np.tile([0, 0, 0.6], (60, 1)))
    view = canonical_view(model("three turns"), poses)
    labels = view.canonical(poses)[:, :3, :3]
    angles = np.linalg.norm(so3.log(np.swapaxes(labels, 1, 2) @ labels[0]), axis=1)
    assert angles.max() < 0.8


def test_no_symmetry_moves_the_invariant_centre() -> None:
    for kind, symmetries in KINDS.items():
        centre = invariant_centre(model(kind))
        assert np.allclose(se3.act(symmetries.transforms(), centre), centre, atol=1e-9)


def test_an_object_without_symmetry_keeps_its_pose() -> None:
    poses = poses_before_camera(np.random.default_rng(0), 4)
    assert canonical_view(model("none"), poses).canonical(poses) is poses


def test_an_object_of_which_there_is_no_picture_has_no_canonical_view() -> None:
    unseen = canonical_view(model("round"), np.empty((0, 4, 4)))
    assert unseen.view is None
    with pytest.raises(ValueError, match="no picture"):
        unseen.canonical(poses_before_camera(np.random.default_rng(0), 1))


def _least_rotation(direction: np.ndarray) -> np.ndarray:
    axis = np.cross([0, 0, 1.0], direction)
    angle = np.arctan2(np.linalg.norm(axis), direction[2])
    return so3.exp(angle * axis / np.linalg.norm(axis))
