from dataclasses import replace

import numpy as np
import pytest

from multicam.dataset.bop_reader import Instance
from multicam.evaluation.detection import IOUS, amodal_box, average_precision, evaluate_detections, match_boxes
from multicam.evaluation.network_tables import detection_table
from multicam.evaluation.points import PointSets
from multicam.evaluation.selection import ASKED, Selection
from multicam.evaluation.single_view import read_split
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.progress import SilentProgress
from multicam.types import Detection

NONE = np.zeros(9, dtype=bool)


def flags(*values: int) -> np.ndarray:
    return np.array(values, dtype=bool)


def test_a_perfect_ranking_has_full_precision():
    assert average_precision([0.9, 0.8], flags(1, 1), flags(0, 0), wanted=2) == 1


def test_average_precision_by_hand():
    # Right, wrong, right; three wanted. Recall 1/3 at precision 1, recall 2/3 at 2/3, the last third never:
    # recalls 0 to 0.33 are 34 of 101 at 1, 0.34 to 0.66 are 33 at 2/3, the other 34 at 0.
    found = average_precision([0.9, 0.8, 0.7], flags(1, 0, 1), flags(0, 0, 0), wanted=3)
    assert found == pytest.approx((34 + 33 * 2 / 3) / 101)


def test_a_wrong_start_costs_only_what_no_later_recall_makes_good():
    # Precision is 0 after the first and 1/2 after the second; recall 0 is credited with the best to come.
    assert average_precision([0.9, 0.8], flags(0, 1), flags(0, 0), wanted=1) == 0.5


def test_the_order_of_detections_is_that_of_their_scores():
    mixed = average_precision([0.7, 0.9, 0.8], flags(1, 1, 0), flags(0, 0, 0), wanted=3)
    assert mixed == average_precision([0.9, 0.8, 0.7], flags(1, 0, 1), flags(0, 0, 0), wanted=3)


def test_ignored_detections_are_neither_right_nor_wrong():
    assert average_precision([0.9, 0.8], flags(0, 1), flags(1, 0), wanted=1) == 1


def test_nothing_found_is_nothing():
    assert average_precision([], flags(), flags(), wanted=3) == 0
    assert average_precision([0.5], flags(0), flags(0), wanted=3) == 0


def test_each_box_takes_the_free_truth_it_overlaps_most():
    overlaps = np.array([[0.6, 0.7], [0.2, 0.9], [0.55, 0.3]])
    assert match_boxes(overlaps, flags(0, 0), 0.5) == [1, None, 0]
    assert match_boxes(overlaps, flags(0, 0), 0.65) == [1, None, None]
    # The overlap asked for is enough.
    assert match_boxes(np.array([[0.5]]), flags(0), 0.5) == [0]


def test_an_ignored_truth_is_taken_only_if_there_is_no_other():
    overlaps = np.array([[0.6, 0.9], [0.6, 0.9]])
    assert match_boxes(overlaps, flags(0, 1), 0.5) == [0, 1]


def test_no_truths_take_nothing():
    assert match_boxes(np.zeros((2, 0)), flags(), 0.5) == [None, None]


def test_a_box_that_no_label_states_is_around_the_projected_mesh(toy_recording):
    points = PointSets(toy_recording.catalogue)
    camera = Camera.from_focal(600.0, 640, 480)
    pose = se3.exp(np.array([0, 0, 0, 0, 0, 1.0]))
    # The plate is 120 x 60 x 20 mm: its near face is 0.99 m away.
    half = 600 / 0.99 * np.array([0.06, 0.03])
    middle = np.array([319.5, 239.5])
    expected = np.concatenate((middle - half, middle + half))
    np.testing.assert_allclose(amodal_box(Instance(2, pose), camera, points), expected, atol=1e-3)
    stated = np.array([1.0, 2, 3, 4])
    assert amodal_box(Instance(2, pose, stated), camera, points) is stated


def detections_of(records, score: float = 0.9, shift: float = 0.0) -> dict[tuple[int, int], list[Detection]]:
    """The labels' boxes, moved right by a share of their width."""
    return {
        (r.scene_id, r.im_id): [
            Detection(
                i.obj_id,
                score,
                i.box + shift * np.array([1, 0, 1, 0]) * (i.box[2] - i.box[0]),
                i.keypoints,
                np.ones(8),
                np.ones((8, 2)),
            )
            for i in r.instances
        ]
        for r in records
    }


def judge(recording, detections, selection=ASKED):
    records = read_split(recording.folder / "test", {})
    return evaluate_detections(detections, records, PointSets(recording.catalogue), selection, SilentProgress())


def rows_of(classes, recording, least_score=0.3):
    return detection_table(classes, recording.catalogue, least_score).to_plain()["rows"]


def test_the_labels_themselves_are_found_perfectly(toy_recording):
    records = read_split(toy_recording.folder / "test", {})
    classes = judge(toy_recording, detections_of(records))
    for row in rows_of(classes, toy_recording):
        assert [row[n] for n in ("AP %", "AP50 %", "AP75 %", "recall %", "precision %")] == [100] * 5
    asked = sum(ASKED.takes(i) for r in records for i in r.instances)
    assert sum(own.wanted for own in classes.values()) == sum(len(own.found) for own in classes.values()) == asked


def test_boxes_moved_by_a_tenth_pass_seven_of_ten_overlaps(toy_recording):
    # Moved by a tenth of the width, 0.9 of 1.1 widths are common: 0.818.
    records = read_split(toy_recording.folder / "test", {})
    # Several instances of one class could swap partners, but none overlap that much here.
    for row in rows_of(judge(toy_recording, detections_of(records, shift=0.1)), toy_recording):
        assert row["AP %"] == pytest.approx(100 * np.mean([iou < 0.818 for iou in IOUS]))
        assert row["AP50 %"] == row["AP75 %"] == 100


def test_weak_detections_count_for_ap_but_are_not_believed(toy_recording):
    records = read_split(toy_recording.folder / "test", {})
    for row in rows_of(judge(toy_recording, detections_of(records, score=0.2)), toy_recording):
        assert (row["AP %"], row["recall %"], row["precision %"]) == (100, 0, None)


def test_detections_where_there_is_no_object_cost_precision(toy_recording):
    records = read_split(toy_recording.folder / "test", {})
    found = detections_of(records)
    doubled = {key: own + [replace(d, box=d.box + 1000, score=0.95) for d in own] for key, own in found.items()}
    for row in rows_of(judge(toy_recording, doubled), toy_recording):
        assert row["recall %"] == 100
        # Objects less than a tenth visible have detections too, which are ignored, but their doubles are not.
        assert row["precision %"] <= 50
        assert row["AP50 %"] <= 51


def test_objects_that_are_not_selected_are_ignored(toy_recording):
    records = read_split(toy_recording.folder / "test", {})
    near = Selection(0.0, 0.9)
    classes = judge(toy_recording, detections_of(records), near)
    assert sum(own.wanted for own in classes.values()) == sum(near.takes(i) for r in records for i in r.instances)
    for row in rows_of(classes, toy_recording):
        assert (row["AP %"], row["precision %"]) == (100, 100)
