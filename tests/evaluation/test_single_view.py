from dataclasses import replace

import numpy as np
import pytest

from multicam.dataset.results import Estimates
from multicam.errors import DataError
from multicam.evaluation.single_view import ObjectErrors, evaluate_estimates, read_split, single_view_table
from multicam.geometry import se3
from multicam.progress import SilentProgress
from tests.toy_objects import PLATE, random_symmetry, toy_symmetries
from tests.toy_recording import truth_as_estimates


def evaluate(recording, estimates: Estimates) -> dict[int, list[ObjectErrors]]:
    records = read_split(recording.folder / "test", estimates)
    return evaluate_estimates(estimates, records, recording.catalogue, SilentProgress())


def test_the_truth_has_no_errors(toy_recording):
    errors = evaluate(toy_recording, truth_as_estimates(toy_recording))
    assert all(max(e.add, e.mssd, e.mspd) < 1e-5 for found in errors.values() for e in found)
    for row in single_view_table(errors, toy_recording.catalogue).to_plain()["rows"]:
        assert (row["found %"], row["within 0.1 d %"], row["AR MSSD %"], row["AR MSPD %"]) == (100, 100, 100, 100)
        assert row["AUC %"] == pytest.approx(100, abs=0.1)


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
    assert max(max(e.add, e.mssd, e.mspd) for e in errors) < 1e-5


def test_missing_estimates_are_infinite_errors(toy_recording):
    errors = evaluate(toy_recording, {})
    assert all(np.isinf(e.add) for found in errors.values() for e in found)
    rows = single_view_table(errors, toy_recording.catalogue).to_plain()["rows"]
    assert rows[-1]["object"] == "mean of classes"
    assert rows[-1]["AUC %"] == 0
    assert rows[0]["median mm"] is None


def test_a_shift_of_ten_millimetres_is_seen_in_all_three_errors(toy_recording):
    shift = np.array([0, 0, 0, 0.01, 0, 0])
    estimates = {
        key: [replace(e, camera_from_object=se3.plus(e.camera_from_object, shift)) for e in found]
        for key, found in truth_as_estimates(toy_recording).items()
    }
    for error in (e for found in evaluate(toy_recording, estimates).values() for e in found):
        assert 0 < error.add <= 0.01 + 1e-9
        assert 0 < error.mssd <= 0.01 + 1e-9
        # Focal length 600 px at a width of 640: 10 mm at 0.7 to 1.2 m are at most 9 px.
        assert error.mspd < 9


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
