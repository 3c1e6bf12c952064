"""Keypoints of an unsure network, put as far apart as they are."""

from __future__ import annotations

import numpy as np

from multicam.types import FloatArray


def undo_shrinkage(keypoints: FloatArray, std: FloatArray) -> FloatArray:
    """Keypoints (k, 2) whose spread is the one to be expected, from the network's expectations.

    A network that learnt a likelihood answers the expectation m of a place x, and where it is unsure of the attitude
    the expectations of all keypoints crowd together: the object looks smaller, so further away, than it is. How much is
    missing it says itself, in its standard deviations s: with the mean c of the keypoints, E|x - c|^2 = |m - c|^2 +
    s_x^2 + s_y^2 (law of total variance). All keypoints move away from c by the factor that restores the sum.

    Args:
        keypoints: (k, 2) pixels.
        std: (k, 2) standard deviations, pixels. Rows of either that are not finite count for nothing.
    """
    usable = np.isfinite(keypoints).all(axis=1) & np.isfinite(std).all(axis=1)
    if not usable.any():
        return keypoints
    centre = keypoints[usable].mean(axis=0)
    square = float(np.sum((keypoints[usable] - centre) ** 2))
    if square == 0:
        return keypoints
    return centre + np.sqrt(1 + float(np.sum(std[usable] ** 2)) / square) * (keypoints - centre)
