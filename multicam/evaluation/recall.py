"""From lists of errors to recall and area under the curve. A missing estimate is an infinite error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

BOP_SHARES = tuple(np.arange(1, 11) * 0.05)
"""Thresholds of MSSD as shares of the diameter: 5 % to 50 %."""

BOP_PIXELS = tuple(np.arange(1, 11) * 5.0)
"""Thresholds of MSPD in pixels of an image 640 wide."""


def recall(errors: ArrayLike, threshold: float) -> float:
    """Share of errors below a threshold; NaN of no errors at all."""
    values = np.asarray(errors, dtype=np.float64)
    return float(np.mean(values < threshold)) if values.size else float("nan")


def average_recall(errors: ArrayLike, thresholds: Sequence[float]) -> float:
    """Recall averaged over thresholds (BOP's AR of one error)."""
    return float(np.mean([recall(errors, threshold) for threshold in thresholds]))


def auc_posecnn(errors: ArrayLike, limit: float = 0.1) -> float:
    """Area under the accuracy-threshold curve up to `limit` metres, as share in [0, 1]; NaN of no errors.

    PoseCNN's own way (VOC): sorted errors, those beyond the limit infinite, accuracy k/n at the k-th, monotone
    envelope, and between two errors the accuracy at the right end.
    """
    values = np.sort(np.asarray(errors, dtype=np.float64))
    if not values.size:
        return float("nan")
    reached = values[values <= limit]
    if not reached.size:
        return 0.0
    accuracy = np.arange(1, reached.size + 1) / values.size
    edges = np.concatenate(([0.0], reached, [limit]))
    heights = np.concatenate((accuracy, accuracy[-1:]))
    return float(np.sum(np.diff(edges) * heights) / limit)


def median(errors: ArrayLike) -> float:
    """Median with missing estimates counted as infinite; NaN of no errors."""
    values = np.asarray(errors, dtype=np.float64)
    return float(np.median(values)) if values.size else float("nan")
