from dataclasses import replace

import cv2
import numpy as np
import pytest

from multicam.dataset.results import Estimates
from multicam.errors import DataError
from multicam.evaluation.points import PointSets
from multicam.evaluation.pose_error import mspd
from multicam.evaluation.single_view import ObjectErrors, by_score, camera_of, evaluate_estimates, read_split
from multicam.evaluation.single_view_tables import add_table, distance_table, single_view_table, visibility_table
from multicam.geometry import se3
from multicam.progress import SilentProgress
from tests.toy_objects import PLATE, random_symmetry, toy_symmetries
from tests.toy_recording import truth_as_estimates


def evaluate(recording, estimates: Estimates, surfaces: bool = False) -> dict[int, list[ObjectErrors]]:
    records = read_split(recording.folder / "test", estimates)
    return evaluate_estimates(estimates, records, PointSets(recording.catalogue), SilentProgress(), surfaces)


def moved(recording, twist: list[float]) -> Estimates:
    """The truth with every pose perturbed on the right."""
    return {
        key: [replace(e, camera_from_object=se3.plus(e.camera_from_object, np.array(twist))) for e in found]
        for key, found in truth_as_estimates(recording).items()
    }


def test_the_truth_has_no_errors(toy_recording):
    errors = evaluate(toy_recording, truth_as_estimates(toy_recording), surfaces=True)
    assert all(max(e.add, e.add_s, e.mssd, e.mspd) < 1e-9 for found in errors.values() for e in found)
    names = ("found %", "within 0.1 d %", "AR VSD %", "AR MSSD %", "AR MSPD %", "AR %")
    tables = [table(errors, toy_recording.catalogue) for table in (single_view_table, distance_table, visibility_table)]
    for row in (row for table in tables for row in table.to_plain()["rows"] if row["asked"]):
        assert [row[name] for name in names] == [100] * 6
        assert row["AUC %"] == pytest.approx(100, abs=1e-9)
    for row in add_table(errors, toy_recording.catalogue).to_plain()["rows"]:
        assert row["ADD 0.1 d %"] == row["ADD-S 0.1 d %"] == 100


def test_the_order_of_rows_does_not_matter_even_among_equal_scores(toy_recording, rng):
    estimates = moved(toy_recording, [0.1, 0, 0, 0.01, 0, 0])
    # A second guess with the same score: which of the two is taken must not depend on the file.
    doubled = {
        key: found + [replace(e, camera_from_object=se3.plus(e.camera_from_object, np.full(6, 0.02))) for e in found]
        for key, found in estimates.items()
    }
    shuffled = {key: [found[i] for i in rng.permutation(len(found))] for key, found in doubled.items()}
    tables = [
        single_view_table(evaluate(toy_recording, some), toy_recording.catalogue).to_csv()
        for some in (doubled, shuffled)
    ]
    assert tables[0] == tables[1]


def test_the_best_score_comes_first(toy_recording):
    found = next(iter(truth_as_estimates(toy_recording).values()))
    best = replace(found[-1], score=0.8)
    assert by_score([*found[:-1], best])[0] is best


def test_what_hides_behind_nothing_but_is_drawn_in_front_of_it_costs_visible_surface(toy_recording):
    # 50 mm towards the camera and beyond half of all diameters: nothing of the surface agrees to 5 % of the diameter.
    errors = evaluate(toy_recording, moved(toy_recording, [0, 0, 0, 0.05, 0, 0]), surfaces=True)
    shares = [e.vsd_share for found in errors.values() for e in found]
    assert all(share is not None and share < 1 for share in shares)


def test_without_depth_there_is_no_vsd_and_the_table_says_so(toy_recording):
    errors = evaluate(toy_recording, truth_as_estimates(toy_recording))
    table = single_view_table(errors, toy_recording.catalogue)
    names = [column.name for column in table.columns]
    assert "AR VSD %" not in names
    assert "AR %" not in names
    assert "AR without VSD %" in names
    assert "without depth images there is no VSD" in table.note


def test_bins_hold_every_object_once(toy_recording):
    errors = evaluate(toy_recording, truth_as_estimates(toy_recording))
    count = sum(len(found) for found in errors.values())
    for table in (distance_table, visibility_table):
        assert sum(row["asked"] for row in table(errors, toy_recording.catalogue).to_plain()["rows"]) == count


def test_visible_fractions_that_are_not_stated_are_not_invented(toy_recording):
    errors = evaluate(toy_recording, truth_as_estimates(toy_recording))
    blind = {
        i: [replace(e, truth=replace(e.truth, visible_fraction=None)) for e in found] for i, found in errors.items()
    }
    assert visibility_table(blind, toy_recording.catalogue) is None


def test_an_image_whose_depth_has_another_size_is_refused(toy_recording, tmp_path):
    records = read_split(toy_recording.folder / "test", {})[:1]
    cv2.imwrite(str(tmp_path / "depth.png"), np.ones((3, 4), dtype=np.uint16))
    odd = [replace(records[0], depth_path=tmp_path / "depth.png")]
    points = PointSets(toy_recording.catalogue)
    with pytest.raises(DataError, match="is 4 x 3 pixels but its picture 160 x 120"):
        evaluate_estimates({}, odd, points, SilentProgress(), surfaces=True)
    with pytest.raises(DataError, match="has no depth image"):
        evaluate_estimates({}, [replace(records[0], depth_path=None)], points, SilentProgress(), surfaces=True)


def test_symmetric_twins_have_no_errors(toy_recording, rng):
    estimates = {
        key: [
            replace(e, camera_from_object=e.camera_from_object @ random_symmetry(toy_symmetries()[e.obj_id], rng))
            for e in found
            if e.obj_id == PLATE
        ]
        for key, found in truth_as_estimates(toy_recording).items()
    }
    errors = evaluate(toy_recording, estimates)[PLATE]
    assert max(max(e.add_or_add_s, e.mssd, e.mspd) for e in errors) < 1e-5


def test_missing_estimates_are_infinite_errors(toy_recording):
    errors = evaluate(toy_recording, {})
    assert all(np.isinf(e.add_or_add_s) and np.isinf(e.mspd) for found in errors.values() for e in found)
    rows = single_view_table(errors, toy_recording.catalogue).to_plain()["rows"]
    assert rows[-1]["object"] == "mean of classes"
    assert rows[-1]["AUC %"] == 0
    assert rows[0]["median mm"] is None


def test_a_shift_of_ten_millimetres_is_seen_in_all_three_errors(toy_recording):
    estimates = moved(toy_recording, [0, 0, 0, 0.01, 0, 0])
    for error in (e for found in evaluate(toy_recording, estimates).values() for e in found):
        assert 0 < error.add_or_add_s <= error.add + 1e-9 <= 0.01 + 2e-9
        assert 0 < error.mssd <= 0.01 + 1e-9
        # Focal length 600 px at a width of 640: 10 mm at 0.7 to 1.2 m are at most 9 px.
        assert error.mspd < 9


def test_pixels_are_those_of_an_image_640_wide(toy_recording):
    # The pictures are 160 wide.
    points = PointSets(toy_recording.catalogue)
    for found in evaluate(toy_recording, moved(toy_recording, [0, 0, 0, 0.01, 0, 0])).values():
        e, obj_id = found[0], found[0].truth.obj_id
        poses = e.estimate.camera_from_object, e.truth.camera_from_object
        own = mspd(*poses, points.symmetries(obj_id), points[obj_id], camera_of(e.record))
        assert e.mspd == pytest.approx(4 * own)


def test_the_better_scored_of_two_guesses_answers(toy_recording):
    wrong = {
        key: [
            replace(e, score=0.9, camera_from_object=se3.plus(e.camera_from_object, np.array([0, 0, 0, 0.3, 0, 0])))
            for e in found
        ]
        + found
        for key, found in truth_as_estimates(toy_recording).items()
    }
    table = single_view_table(evaluate(toy_recording, wrong), toy_recording.catalogue).to_plain()["rows"]
    assert table[-1]["within 0.1 d %"] == 0


def test_estimates_for_images_that_do_not_exist_are_refused(toy_recording):
    with pytest.raises(DataError, match=r"scene 7, image 3, which .* lacks"):
        evaluate(toy_recording, {(7, 3): []})
