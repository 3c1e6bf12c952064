"""Symmetries of several classes as flat arrays, so that estimates of all classes are handled at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.geometry import se3
from multicam.geometry.symmetry import Axis
from multicam.matching.arrays import IntArray
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class SymmetryTable:
    """Discrete symmetries (identity first) of each class, one after the other, and its continuous axis.

    Attributes:
        obj_ids: (c,) classes, ascending.
        start, count: (c,) where the transforms of a class stand.
        transforms: (s, 4, 4) object_from_object.
        axis: (c, 6) unit twist about the axis in the object frame, zero where there is none. Of several axes (no known
            object has them) the first.
        centre: (c, 3) a point that every symmetry leaves where it is, metres.
    """

    obj_ids: IntArray
    start: IntArray
    count: IntArray
    transforms: FloatArray
    axis: FloatArray
    centre: FloatArray

    @classmethod
    @lru_cache(maxsize=4)
    def of(cls, catalogue: Catalogue) -> SymmetryTable:
        """The table of a catalogue; made once."""
        symmetries = [model.symmetries for model in catalogue.objects.values()]
        blocks = [np.concatenate((np.eye(4)[None], s.discrete)) for s in symmetries]
        count = np.array([len(block) for block in blocks], dtype=np.int64)
        axis = np.array([axis_twist(s.axes[0]) if s.axes else np.zeros(6) for s in symmetries]).reshape(-1, 6)
        # The mean of a point's images under a group stays where it is; a point of the axis stays under turns too.
        points = [s.axes[0].offset if s.axes else np.zeros(3) for s in symmetries]
        centres = [se3.act(block, point).mean(axis=0) for block, point in zip(blocks, points, strict=True)]
        return cls(
            np.array(catalogue.obj_ids, dtype=np.int64), np.cumsum(count) - count, count,
            np.concatenate([np.zeros((0, 4, 4)), *blocks]), axis, np.array(centres).reshape(-1, 3),
        )  # fmt: skip

    def rows(self, obj_id: IntArray) -> IntArray:
        """Row of each class in the table."""
        return np.searchsorted(self.obj_ids, obj_id)


def axis_twist(axis: Axis) -> FloatArray:
    """(6,) twist whose exponential, times an angle, is the rotation about the axis."""
    return np.concatenate((axis.direction, np.cross(axis.offset, axis.direction)))
