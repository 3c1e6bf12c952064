"""What is lost between two files, by hand: networks that answer from tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from export.config import LossLimits
from export.loss import Loss, measure_loss
from export.pictures import Picture
from multicam.dataset.bop_reader import ImageRecord, Instance
from multicam.dataset.objects import Catalogue
from multicam.errors import ModelError
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.inference.session import Network
from multicam.progress import SilentProgress
from tests.inference.toy_network import HEIGHT, WIDTH, Answer, answer, picture_for, toy_metadata, write_network

BOXES = [[0, 0, 10, 10], [20, 20, 40, 40], [42, 0, 62, 20]]
MATRIX = np.array([[100.0, 0, 32], [0, 100, 24], [0, 0, 1]])


def network(folder: Path, catalogue: Catalogue, rows: Answer) -> Network:
    folder.mkdir()
    return Network(write_network(folder / "x.onnx", [rows], toy_metadata(catalogue).to_json()))


def loss(before: Network, after: Network, pictures: Sequence[Picture] = ()) -> Loss:
    return measure_loss(before, after, pictures or [Picture(picture_for(0))], SilentProgress())


def test_a_file_loses_nothing_against_itself(tmp_path: Path, catalogue: Catalogue) -> None:
    same = network(tmp_path / "a", catalogue, answer([0, 1, 2], [0.9, 0.8, 0.7], BOXES))
    found = loss(same, same)
    assert (found.detections, found.same, found.new) == (3, 1, 0)
    assert found.box_px.most == found.keypoint_px.most == found.score.most == 0
    found.require(LossLimits(least_same=1, most_keypoint_px=1e-9, most_recall=0))


def test_what_stays_what_is_new_and_what_moves_are_told_apart(tmp_path: Path, catalogue: Catalogue) -> None:
    points = np.zeros((3, 8, 2))
    before = network(tmp_path / "a", catalogue, answer([0, 1, 2], [0.9, 0.8, 0.7], BOXES, points))
    # The first moves by (0, 2) in box and (3, 4) in keypoints, the second becomes another class, the third falls
    # below the score that counts.
    moved = [[0, 0, 10, 12], BOXES[1], BOXES[2]]
    after = network(tmp_path / "b", catalogue, answer([0, 2, 2], [0.8, 0.8, 0.1], moved, points + np.array([3, 4])))
    found = loss(before, after)
    assert (found.detections, found.same, found.new) == (3, pytest.approx(1 / 3), 0.5)
    assert (found.box_px.median, found.keypoint_px.median) == (2, pytest.approx(5))
    assert found.score.median == pytest.approx(0.1)
    assert found.truth is None
    assert "33.3 % stay, 50.0 % of its own are new" in found.lines()[0]
    assert "boxes 2.00, 2.00 px, keypoints 5.00, 5.00 px" in found.lines()[1]


def test_one_detection_is_not_found_twice(tmp_path: Path, catalogue: Catalogue) -> None:
    twice = [[0, 0, 10, 10], [3, 0, 13, 10], [20, 20, 40, 40]]
    before = network(tmp_path / "a", catalogue, answer([0, 0, 1], [0.9, 0.8, 0.7], twice))
    after = network(tmp_path / "b", catalogue, answer([0, 1, 1], [0.9, 0.7, 0.1], [twice[0], twice[2], twice[2]]))
    assert loss(before, after).same == pytest.approx(2 / 3)


def test_the_truth_gives_recall_and_keypoint_error(tmp_path: Path, catalogue: Catalogue) -> None:
    obj_ids = catalogue.obj_ids
    pose = se3.from_parts(np.eye(3), np.array([0.0, 0, 1]))
    true = Camera(MATRIX, WIDTH, HEIGHT).project(se3.act(pose, catalogue[obj_ids[0]].keypoints))
    instances = tuple(
        Instance(obj_id, pose, np.array(box, dtype=np.float64), visible)
        for obj_id, box, visible in (
            (obj_ids[0], BOXES[0], 1.0),
            (obj_ids[1], BOXES[1], 1.0),
            (obj_ids[1], BOXES[2], 0),
        )
    )
    path = tmp_path / "picture.png"
    cv2.imwrite(str(path), picture_for(0))
    record = ImageRecord(0, 0, MATRIX, None, 1.0, path, None, (), instances)
    points = np.stack([true + np.array([0, 2]), np.zeros_like(true)])
    before = network(tmp_path / "a", catalogue, answer([0, 1], [0.9, 0.8], BOXES[:2], points))
    after = network(tmp_path / "b", catalogue, answer([0, 1], [0.9, 0.1], BOXES[:2], points + np.array([0, 1])))
    found = loss(before, after, [Picture(picture_for(0), record)])
    assert found.truth is not None
    one, other = found.truth
    # The third object is hidden, and not asked for.
    assert (one.recall, other.recall) == (1, 0.5)
    assert other.keypoint_px == pytest.approx(3, abs=1e-3)
    assert "recall 100.0 -> 50.0 %" in found.lines()[2]
    with pytest.raises(ModelError, match=r"recall falls by 50\.0 %, and loss\.most_recall is 0\.02"):
        found.require(LossLimits(least_same=0.5, most_keypoint_px=2))


def test_too_few_that_stay_are_refused_with_the_figure(tmp_path: Path, catalogue: Catalogue) -> None:
    before = network(tmp_path / "a", catalogue, answer([0, 1], [0.9, 0.8], BOXES[:2]))
    after = network(tmp_path / "b", catalogue, answer([0, 1], [0.9, 0.1], BOXES[:2]))
    with pytest.raises(ModelError, match=r"50\.0 % of the detections stay, and loss\.least_same is 0\.9"):
        loss(before, after).require(LossLimits())


def test_moved_keypoints_are_refused_with_the_figure(tmp_path: Path, catalogue: Catalogue) -> None:
    points = np.zeros((1, 8, 2))
    before = network(tmp_path / "a", catalogue, answer([0], [0.9], BOXES[:1], points))
    after = network(tmp_path / "b", catalogue, answer([0], [0.9], BOXES[:1], points + np.array([0, 0.75])))
    with pytest.raises(ModelError, match=r"keypoints move by 0\.75 px"):
        loss(before, after).require(LossLimits())


def test_pictures_that_show_nothing_prove_nothing(tmp_path: Path, catalogue: Catalogue) -> None:
    silent = network(tmp_path / "a", catalogue, answer([0], [0.1], BOXES[:1]))
    with pytest.raises(ModelError, match="finds nothing in 1 pictures"):
        loss(silent, silent).require(LossLimits())
