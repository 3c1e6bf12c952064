import numpy as np
import pytest

from multicam.dataset.bop_reader import Instance
from multicam.errors import ConfigError, DataError
from multicam.evaluation.selection import ASKED, DISTANCE_BINS, VISIBILITY_BINS, Selection, distance
from multicam.geometry import se3


def at(metres: float, visible: float | None = 1.0) -> Instance:
    pose = se3.from_parts(np.eye(3), np.array([0, 0.6 * metres, 0.8 * metres]))
    return Instance(1, pose, visible_fraction=visible)


def test_distance_is_from_the_camera_not_along_its_axis():
    assert distance(at(0.5)) == pytest.approx(0.5)


def test_the_first_distance_belongs_and_the_second_does_not():
    selection = Selection(0.5, 1.0)
    assert [selection.takes(at(d)) for d in (0.4999, 0.5, 0.9999, 1.0)] == [False, True, True, False]


def test_objects_a_tenth_visible_are_asked_for():
    assert [ASKED.takes(at(1, v)) for v in (0.099, 0.1, None)] == [False, True, True]


@pytest.mark.parametrize("bins", [DISTANCE_BINS, VISIBILITY_BINS])
def test_bins_neither_overlap_nor_leave_gaps(bins, rng):
    for truth in (at(d, v) for d, v in zip(rng.uniform(0.1, 2, 200), rng.uniform(0.1, 1, 200), strict=True)):
        assert sum(selection.takes(truth) for selection in bins.values()) == 1
    assert sum(selection.takes(at(1.0, 1.0)) for selection in bins.values()) == 1


def test_empty_ranges_and_objects_never_asked_for_are_refused():
    for wrong in ((1.0, 0.5), (-1.0, 0.5), (0.5, 0.5), (float("nan"), 1.0)):
        with pytest.raises(ConfigError, match="hold nothing"):
            Selection(*wrong)
    for wrong in (0.05, 1.5, 50):
        with pytest.raises(ConfigError, match=r"must be 0.1 to 1"):
            Selection(least_visible=wrong)


def test_visibility_that_is_not_stated_cannot_be_asked_for():
    Selection().require_visibility([at(1, None)])
    Selection(least_visible=0.5).require_visibility([at(1, 0.3)])
    with pytest.raises(DataError, match=r"lacks scene_gt_info.json"):
        Selection(least_visible=0.5).require_visibility([at(1, 0.3), at(1, None)])
