"""Groups of records of different lengths laid one after the other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from multicam.matching.arrays import IntArray

RecordArray = NDArray[np.void]


def laid_out(groups: Sequence[RecordArray], record: np.dtype[np.void]) -> tuple[RecordArray, IntArray]:
    """All records, and (n + 1,) where each group begins, with the end; there may be no group at all."""
    start = np.zeros(len(groups) + 1, dtype=np.int64)
    np.cumsum([len(group) for group in groups], out=start[1:])
    # As bytes, for NumPy copies records field by field.
    every = [np.ascontiguousarray(group).view(np.uint8) for group in groups]
    return np.concatenate(every or [np.empty(0, np.uint8)]).view(record), start
