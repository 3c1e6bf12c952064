"""Poses at which a detected object may stand, whatever its keypoints say: even attitudes, placed by box and depth."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np

from multicam.bundle.depth_image import DepthImage
from multicam.bundle.tracking import Sight
from multicam.bundle.viewpoints.model import ViewpointModel
from multicam.fitting.agreement import confirmed
from multicam.fitting.config import FitConfig
from multicam.fitting.sampled import outline_sides, surface_errors
from multicam.geometry import so3
from multicam.types import FloatArray

_PHI, _PSI = np.sqrt(2.0), 1.533751168755204288118041

_PREFERRED = 1 / 3
"""Share of the attitudes, those whose outline is most like the box, that are compared with the depth."""

_UNLIKE = 0.3
"""What a unit of the logarithm of sides (drawn over detected, both sides together) takes from a share of points."""


@cache
def even_rotations(count: int) -> FloatArray:
    """(count, 3, 3) rotations spread evenly over all: super-Fibonacci spirals (Alexa, CVPR 2022)."""
    s = np.arange(count) + 0.5
    inner, outer = np.sqrt(s / count), np.sqrt(1 - s / count)
    a, b = 2 * np.pi * s / _PHI, 2 * np.pi * s / _PSI
    x, y, z, w = inner * np.sin(a), inner * np.cos(a), outer * np.sin(b), outer * np.cos(b)
    vector = np.stack((x, y, z), axis=1)
    half = np.arctan2(np.linalg.norm(vector, axis=1), w)
    axis = vector / np.linalg.norm(vector, axis=1, keepdims=True).clip(1e-12)
    return so3.exp(2 * half[:, None] * axis)


def poses_at_box(
    sight: Sight, depth: DepthImage, model: ViewpointModel, centre: FloatArray, box: FloatArray, config: FitConfig
) -> Iterator[tuple[float, FloatArray]]:
    """Poses (4, 4) whose outline is like a box, moved to the measured depth, with how well box and depth bear them out.

    There are none where no depth was measured in the box.

    Args:
        depth: that of the sight.
        centre: (3,) middle of the object in its frame.
        box: (4,) x0 y0 x1 y1 of a detection.
    """
    distance = _distance(depth, box)
    if distance is None or not config.attitudes:
        return
    ray = sight.camera.unproject((box[:2] + box[2:]) / 2, np.ones(()))
    poses = np.tile(np.eye(4), (config.attitudes, 1, 1))
    poses[:, :3, :3] = even_rotations(config.attitudes)
    poses[:, :3, 3] = distance * ray - poses[:, :3, :3] @ centre
    sides = outline_sides(model, sight.camera.matrix, poses).clip(1)
    unlike = np.abs(np.log(sides / (box[2:] - box[:2]).clip(1))).sum(axis=1)
    for n in np.argsort(unlike)[: max(round(_PREFERRED * config.attitudes), 1)]:
        pose = poses[n]
        behind = surface_errors(model, depth, pose)
        if len(behind):
            # The middle of the box may show what lies behind the object.
            pose[:3, 3] += np.median(behind) * ray
            yield confirmed(surface_errors(model, depth, pose), config) - _UNLIKE * float(unlike[n]), pose


def _distance(depth: DepthImage, box: FloatArray) -> float | None:
    """Median depth in a box, metres."""
    low = np.floor(box[:2]).astype(int).clip(0, None)
    high = np.ceil(box[2:]).astype(int) + 1
    patch = depth.depth[low[1] : max(high[1], 0), low[0] : max(high[0], 0)]
    patch = patch[np.isfinite(patch) & (patch > 0)]
    return float(np.median(patch)) if len(patch) else None
