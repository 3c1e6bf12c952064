import re

import numpy as np
import pytest

from multicam.dataset.results import Estimates
from multicam.evaluation.points import PointSets
from multicam.evaluation.selection import Selection
from multicam.evaluation.single_view import read_split
from multicam.evaluation.split_error import SplitErrors, evaluate_split
from multicam.evaluation.split_report import split_statements, split_tables
from multicam.geometry import se3
from multicam.progress import SilentProgress
from multicam.types import ObjectEstimate
from multicam.visualization.evaluation_page import write_evaluation_page
from multicam.visualization.worst_cases import ESTIMATED_COLOR, TRUE_COLOR, choose_worst, draw_case, in_words
from tests.toy_objects import BRACKET, PLATE
from tests.toy_recording import truth_as_estimates
from tests.visualization.test_page import Balance


def judge(recording, estimates: Estimates) -> SplitErrors:
    records = read_split(recording.folder / "test", estimates)
    return evaluate_split(records, estimates, None, PointSets(recording.catalogue), Selection(), SilentProgress())


@pytest.fixture(scope="module")
def errors(toy_recording):
    """Truth for all but brackets, which are 30 mm off, and plates, of which there are none."""

    def change(e: ObjectEstimate) -> ObjectEstimate:
        shift = np.array([0, 0, 0, 0.03, 0, 0]) if e.obj_id == BRACKET else np.zeros(6)
        return ObjectEstimate(e.obj_id, e.score, se3.plus(e.camera_from_object, shift))

    estimates = truth_as_estimates(toy_recording)
    return judge(
        toy_recording, {key: [change(e) for e in found if e.obj_id != PLATE] for key, found in estimates.items()}
    )


def test_the_page_stands_alone_and_shows_everything(errors, tmp_path):
    write_evaluation_page(tmp_path / "page.html", errors, split_tables(errors), ["Estimates <x>"], SilentProgress())
    text = (tmp_path / "page.html").read_text()
    assert re.findall(r'(?:src|href)="(?!data:)[^"]*"|https?://(?!www\.w3\.org)[^"\s]+', text) == []
    parser = Balance()
    parser.feed(text)
    assert parser.open == []
    for phrase in (
        "Estimates &lt;x&gt;",
        "By distance</caption>",
        "By visibility</caption>",
        "ADD and ADD-S</caption>",
    ):
        assert phrase in text
    assert "plate, scene" in text
    assert "not found; " in text
    # Nothing of a network is said where there is none.
    assert "Keypoints" not in text


def test_statements_name_what_is_wrong(errors):
    facts, warnings = split_statements(errors)
    assert any("lie within a tenth of their diameter" in fact for fact in facts)
    assert any(text.startswith("Not once within a tenth of the diameter: bracket, plate") for text in warnings)


def test_the_worst_of_each_class_comes_first_then_what_was_not_found(errors):
    worst = choose_worst(errors.poses, errors.catalogue)
    classes = [e.truth.obj_id for e in worst]
    assert classes[0] == BRACKET
    assert classes[-1] == PLATE
    assert worst[-1].estimate is None
    assert sorted(classes) == sorted(set(classes))
    missed = [e for e in errors.poses[PLATE] if e.estimate is None]
    assert worst[-1].truth.visible_fraction == max(e.truth.visible_fraction for e in missed)


def test_a_case_shows_both_outlines_and_says_the_error(errors):
    bracket, plate = choose_worst(errors.poses, errors.catalogue)[0], choose_worst(errors.poses, errors.catalogue)[-1]
    mesh_of = PointSets(errors.catalogue).mesh
    case = draw_case(bracket, errors.catalogue, mesh_of)
    assert case.text.startswith("ADD(-S) 30 mm (0.")
    assert "30 mm and 0° off" in case.text
    for color in (TRUE_COLOR, ESTIMATED_COLOR):
        assert (np.abs(case.picture.astype(int) - color).sum(axis=-1) < 30).any()
    alone = draw_case(plate, errors.catalogue, mesh_of)
    assert not (np.abs(alone.picture.astype(int) - ESTIMATED_COLOR).sum(axis=-1) < 30).any()
    assert in_words(plate, errors.catalogue).startswith("not found; ")
