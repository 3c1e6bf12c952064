"""Index arithmetic for groups of different sizes held in flat arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def ragged(start: IntArray, count: IntArray) -> tuple[IntArray, IntArray]:
    """Flattens ranges: owner (which range) and member (start[owner] + 0, 1, ..., count[owner] - 1) of each element."""
    owner = np.repeat(np.arange(len(count)), count)
    offset = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    return owner, start[owner] + offset


def rank_in_group(group: IntArray) -> IntArray:
    """Position of each element within its group; `group` ascends."""
    return np.arange(len(group)) - np.searchsorted(group, group)
