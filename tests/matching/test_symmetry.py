from __future__ import annotations

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.geometry import se3
from multicam.geometry.symmetry import Axis
from multicam.matching.symmetry import SymmetryTable, axis_twist
from tests.toy_objects import BRACKET, PEG, PEG_OFFSET, PLATE, ROD, toy_catalogue


def test_the_twist_of_an_axis_turns_about_it() -> None:
    axis = Axis(np.array([1.0, 2, -1]), np.array([0.1, 0, 0.3]))
    assert np.allclose(se3.exp(0.7 * axis_twist(axis)), axis.rotation(np.asarray(0.7)))


def test_the_table_holds_each_class() -> None:
    catalogue: Catalogue = toy_catalogue()
    table = SymmetryTable.of(catalogue)
    rows = table.rows(np.array([ROD, BRACKET, PLATE, PEG]))
    assert table.count[rows].tolist() == [2, 1, 4, 1]
    assert np.allclose(table.transforms[table.start], np.eye(4))
    assert np.allclose(table.centre[table.rows(np.array([PEG]))], PEG_OFFSET)
    assert np.any(table.axis[rows], axis=1).tolist() == [True, False, False, True]
