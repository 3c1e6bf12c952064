"""Where static cameras may stand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datagen.recordings.board import place_board
from datagen.recordings.clusters import sample_clusters
from datagen.recordings.config import SequenceConfig
from datagen.recordings.statics import Outlook, Unsuitable, in_image
from datagen.scenes.layout import Table
from datagen.scenes.stock import Stock
from datagen.scenes.viewpoints import look_at
from multicam.geometry.camera import Camera
from tests.strategies import Array

CAMERA = Camera.from_focal(500.0, 640, 480)
POSE = look_at(np.array([0.0, -0.5, 0.5]), np.zeros(3))


def heap(x: float, y: float) -> Array:
    return np.random.default_rng(0).uniform(-0.03, 0.03, (200, 3)) + np.array([x, y, 0.03])


def suits(outlook: Outlook, clearance: float = 0.1) -> bool:
    return outlook.suit(CAMERA, POSE, clearance)


def test_a_place_is_refused_for_each_thing_that_is_wrong_with_it() -> None:
    own = heap(0, 0)
    good = Outlook(own, [], [], own, None)
    assert suits(good)
    # Its own cluster out of the picture, or what moves there; another cluster in it, by a single point or just beside.
    assert not suits(replace(good, own=heap(0.6, 0)))
    assert not suits(replace(good, moving=[heap(0.45, 0)]))
    assert suits(replace(good, moving=[heap(0.1, 0)]))
    assert not suits(replace(good, other=[np.concatenate((heap(0.9, 0), [[0.1, 0, 0]]))]))
    assert suits(replace(good, other=[heap(0.9, 0)]))
    assert not suits(replace(good, other=[np.array([[0.458, 0, 0]])]))
    assert not in_image(CAMERA, POSE, np.array([[0.458, 0, 0]])).any()
    # Something in its way.
    assert not suits(replace(good, obstacles=POSE[:3, 3] + [[0.0, 0.0, 0.09]]))
    assert suits(replace(good, obstacles=POSE[:3, 3] + [[0.0, 0.0, 0.11]]))


def test_the_board_must_be_in_the_picture_and_face_the_camera() -> None:
    own = heap(0, 0)

    def with_board(x: float, y: float, turn: float) -> Outlook:
        board = place_board(Path("b.png"), np.array([x, y]), 20.0, turn, Table(), np.random.default_rng(0))
        return Outlook(own, [], [], own, board)

    assert suits(with_board(0, 0.1, 0))
    assert not suits(with_board(0.5, 0.1, 0))
    assert not suits(with_board(0, 0.1, np.pi))
    assert not suits(with_board(0, 0.1, np.pi / 2))


def test_what_is_behind_a_camera_is_not_in_its_picture() -> None:
    behind = POSE[:3, 3] - POSE[:3, 2]
    assert in_image(CAMERA, POSE, np.stack((np.zeros(3), behind))).tolist() == [True, False]


def test_objects_without_room_are_not_piled_up(stock: Stock) -> None:
    crowded = SequenceConfig(radius=0.01, layout="overlapping")
    with pytest.raises(Unsuitable, match="no room on the table for all objects"):
        sample_clusters(crowded, stock, Table(), np.random.default_rng(0))
