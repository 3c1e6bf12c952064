"""Frames of several cameras to poses: exact keypoints give exact poses, and refusals keep their reasons."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from multicam.dataset.objects import Catalogue
from multicam.geometry import se3, so3
from multicam.geometry.camera import Camera
from multicam.inference.estimator import Estimator
from multicam.inference.session import Network
from multicam.inference.shrinkage import undo_shrinkage
from multicam.types import Frame
from tests.inference.toy_network import HEIGHT, WIDTH, answer, picture_for, toy_metadata, write_network
from tests.toy_objects import BRACKET, WEDGE

LEFT, RIGHT = Camera.from_focal(60.0, WIDTH, HEIGHT), Camera.from_focal(480.0, 8 * WIDTH, 8 * HEIGHT)
BOX = [10.0, 10, 50, 40]


@pytest.fixture
def poses() -> dict[int, np.ndarray]:
    rng = np.random.default_rng(0)
    return {obj_id: se3.from_parts(so3.random(rng), np.array([0.02, -0.01, 0.35])) for obj_id in (BRACKET, WEDGE)}


@pytest.fixture
def estimator(tmp_path: Path, catalogue: Catalogue, poses: dict[int, np.ndarray]) -> Estimator:
    return Estimator(toy_network(tmp_path, catalogue, poses, std=0.001))


def toy_network(folder: Path, catalogue: Catalogue, poses: dict[int, np.ndarray], std: float) -> Network:
    """Answers with exact keypoints, but for those of the wedge in the second picture, which all are one point."""

    def keypoints(obj_id: int) -> np.ndarray:
        points = catalogue[obj_id].keypoints
        assert points is not None
        return LEFT.project(se3.act(poses[obj_id], points))

    def labels(*obj_ids: int) -> list[int]:
        return [catalogue.obj_ids.index(obj_id) for obj_id in obj_ids]

    good = np.stack((keypoints(BRACKET), keypoints(WEDGE)))
    bad = np.stack((keypoints(BRACKET), np.full((8, 2), 20.0)))
    table = [answer(labels(BRACKET, WEDGE), [0.9, 0.6], [BOX, BOX], points, std) for points in (good, bad)]
    return Network(write_network(folder / "toy.onnx", table, toy_metadata(catalogue).to_json()))


def frames() -> list[Frame]:
    return [
        Frame("left", 0, picture_for(0), LEFT),
        Frame("right", 0, picture_for(1, 8 * WIDTH, 8 * HEIGHT), RIGHT),
    ]


def test_exact_keypoints_give_exact_poses_in_every_frame(estimator: Estimator, poses: dict[int, np.ndarray]) -> None:
    left, right = estimator.estimate(frames())
    assert [e.obj_id for e in left] == [BRACKET, WEDGE]
    assert [e.score for e in left] == pytest.approx([0.9, 0.6])
    for estimate in (*left, *right):
        # The second camera is the first, eight times as fine: it sees the object at the same place.
        np.testing.assert_allclose(estimate.camera_from_object, poses[estimate.obj_id], atol=2e-5)
        assert estimate.covariance is not None
        assert np.all(np.linalg.eigvalsh(estimate.covariance) > 0)
        assert estimate.detection is not None


def test_keypoints_are_spread_by_what_their_deviations_say_is_missing(
    tmp_path: Path, catalogue: Catalogue, poses: dict[int, np.ndarray]
) -> None:
    network = toy_network(tmp_path, catalogue, poses, std=3.0)
    left, _ = Estimator(network).estimate(frames())
    raw, _ = network.detect([frame.image for frame in frames()])
    for estimate, detection in zip(left, raw, strict=True):
        assert estimate.detection is not None
        restored = undo_shrinkage(detection.keypoints, detection.std)
        assert estimate.detection.keypoints == pytest.approx(restored)
        assert np.linalg.norm(restored - detection.keypoints, axis=1).max() > 0.1
        # Larger in the picture, so nearer.
        assert estimate.camera_from_object[2, 3] < poses[estimate.obj_id][2, 3] - 1e-3


def test_a_detection_without_a_pose_keeps_its_reason(estimator: Estimator) -> None:
    left, right = estimator.analyse(frames())
    assert left.refusals == ()
    assert [(r.detection.obj_id, r.reason) for r in right.refusals] == [
        (WEDGE, right.refusals[0].reason),
    ]
    assert "span" in right.refusals[0].reason


def test_no_frames_give_no_answers(estimator: Estimator) -> None:
    assert estimator.estimate([]) == []
