"""Depth as a time-of-flight camera gives it, from exact depth.

The model is that of BlenderProc's Azure Kinect noise (PostProcessingUtility, add_kinect_azure_noise): every
measurement comes from a place a fraction of a pixel beside its own, its depth has noise that grows with the distance,
and there is none at the edges of things and on dark surfaces. It ends where the camera's narrow, binned mode does.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from datagen.recordings.config import DepthConfig
from multicam.types import ImageArray

_NOISY_FROM = 0.5
"""Metres up to which the noise does not grow."""
_CELL = np.ones((3, 3), dtype=np.uint8)


def sense_depth(
    depth: NDArray[np.float32], image: ImageArray, config: DepthConfig, rng: np.random.Generator
) -> NDArray[np.float32]:
    """(h, w) float32 metres, 0 where the sensor gives none.

    Args:
        depth: (h, w) exact, metres along the optical axis, 0 where nothing was hit.
        image: (h, w, 3) the picture of the same camera.
    """
    height, width = depth.shape
    rows, columns = np.indices((height, width), dtype=np.float32)
    shift = (config.shift_px * rng.standard_normal((2, height, width), dtype=np.float32)).astype(np.float32)
    shifted = cv2.remap(depth, columns + shift[0], rows + shift[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    deviation = 1e-3 * (config.noise_mm + config.noise_mm_per_m * np.maximum(shifted - _NOISY_FROM, 0))
    noisy = shifted + deviation * rng.standard_normal(depth.shape, dtype=np.float32)
    step = 1e-3 * config.step_mm
    stepped = step * np.rint(noisy.astype(np.float64) / step)
    nearest = cv2.erode(depth, _CELL)
    span = cv2.dilate(depth, _CELL) - nearest
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) / 255
    low, high = config.range_m
    # Beside a place where nothing was hit (0), depth would be mixed with it.
    known = (nearest > 0) & (span <= config.edge_m) & (grey >= config.dark) & (noisy >= low) & (noisy <= high)
    return np.where(known, stepped, 0).astype(np.float32)
