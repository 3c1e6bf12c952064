"""Raw outputs to detections: thresholds, suppression within classes, pixels of the original image."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from multicam.errors import ModelError
from multicam.geometry.boxes import overlap
from multicam.image import Letterbox
from multicam.inference.decode import DecodeConfig, RawDetections, decode, suppress
from tests.inference.toy_network import answer

SAME = Letterbox.fit(64, 48, 64, 48)
A, B = [0.0, 0, 10, 10], [1.0, 1, 11, 11]
FAR = [30.0, 30, 40, 40]


def raw(*args: object, **kwargs: object) -> RawDetections:
    return RawDetections(**answer(*args, **kwargs))  # pyright: ignore[reportArgumentType]


def test_the_weaker_of_two_overlapping_boxes_of_one_class_goes() -> None:
    found = decode(raw([2, 2], [0.9, 0.8], [A, B]), SAME, (1, 5, 9), DecodeConfig())
    assert [(d.obj_id, round(d.score, 3)) for d in found] == [(9, 0.9)]


def test_overlapping_boxes_of_two_classes_stay() -> None:
    found = decode(raw([0, 1], [0.9, 0.8], [A, B]), SAME, (1, 5, 9), DecodeConfig())
    assert [d.obj_id for d in found] == [1, 5]


def test_boxes_apart_stay_unless_the_class_is_full() -> None:
    rows = raw([0, 0, 1], [0.9, 0.8, 0.7], [A, FAR, FAR])
    assert len(decode(rows, SAME, (1, 5), DecodeConfig())) == 3
    assert [d.obj_id for d in decode(rows, SAME, (1, 5), DecodeConfig(max_per_class=1))] == [1, 5]


def test_a_suppressed_box_suppresses_nothing_itself() -> None:
    chain = np.array([[0.0, 0, 10, 10], [0, 2, 10, 12], [0, 4, 10, 14]])
    assert suppress(chain, np.zeros(3, dtype=np.int64), 0.6).tolist() == [0, 2]


@given(st.integers(0, 10**6))
def test_suppression_keeps_no_rivals_and_loses_no_box_without_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low = rng.uniform(0, 20, (12, 2))
    boxes, labels = np.c_[low, low + rng.uniform(5, 15, (12, 2))], rng.integers(0, 3, 12)
    kept = suppress(boxes, labels, 0.5)
    rival = (overlap(boxes, boxes) > 0.5) & (labels[:, None] == labels)
    inside = rival[np.ix_(kept, kept)]
    assert inside.sum() == len(kept)
    gone = np.setdiff1d(np.arange(12), kept)
    assert all(rival[g, kept[kept < g]].any() for g in gone)


def test_weak_and_undefined_scores_are_dropped() -> None:
    found = decode(raw([0, 0, 0], [0.31, 0.29, np.nan], [A, FAR, FAR]), SAME, (1,), DecodeConfig())
    assert len(found) == 1


def test_pixels_lead_back_to_the_original_image() -> None:
    letterbox = Letterbox.fit(200, 100, 64, 48)
    source = np.random.default_rng(0).uniform(0, 100, (1, 8, 2))
    corners = np.array([[10.0, 20], [150, 90]])
    rows = raw([0], [0.9], letterbox.to_input(corners).reshape(1, 4).tolist(), letterbox.to_input(source), std=0.64)
    (found,) = decode(rows, letterbox, (7,), DecodeConfig())
    np.testing.assert_allclose(found.keypoints, source[0], atol=1e-4)
    np.testing.assert_allclose(found.box, corners.reshape(4), atol=1e-4)
    np.testing.assert_allclose(found.std, 2.0, rtol=1e-6)


def test_a_label_beyond_the_classes_is_refused() -> None:
    with pytest.raises(ModelError, match="class index 3"):
        decode(raw([3], [0.9], [A]), SAME, (1, 5), DecodeConfig())


def test_no_rows_give_no_detections() -> None:
    assert decode(raw([], [], []), SAME, (1,), DecodeConfig()) == []
