"""Axis-aligned boxes in an image, x0 y0 x1 y1 in pixels."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64


def overlap(a: Float64[np.ndarray, "n 4"], b: Float64[np.ndarray, "m 4"]) -> Float64[np.ndarray, "n m"]:
    """(n, m) intersection over union of boxes (n, 4) and (m, 4); 0 for empty boxes."""
    low = np.maximum(a[:, None, :2], b[:, :2])
    high = np.minimum(a[:, None, 2:], b[:, 2:])
    common = np.clip(high - low, 0, None).prod(axis=-1)
    return common / np.maximum(_areas(a)[:, None] + _areas(b) - common, 1e-12)


def _areas(boxes: np.ndarray) -> np.ndarray:
    return np.clip(boxes[:, 2:] - boxes[:, :2], 0, None).prod(axis=-1)
