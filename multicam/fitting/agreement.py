"""How well measured depth and colours bear out a pose."""

from __future__ import annotations

import numpy as np

from multicam.bundle.adjustment.scene import Body
from multicam.bundle.adjustment.search import DRAWN
from multicam.bundle.depth_image import DepthImage, draw_bodies
from multicam.bundle.tracking import Tracked
from multicam.fitting.config import FitConfig
from multicam.types import FloatArray


def drawn_errors(body: Body, depth: DepthImage, camera_from_object: FloatArray) -> FloatArray:
    """(n,) by how much measured depth lies behind a body drawn at a pose (4, 4), metres.

    At the pixels, at half size, that it covers and whose depth is known.
    """
    drawn = draw_bodies([(body.mesh, depth.depth_from_camera @ camera_from_object)], depth.camera.scaled(DRAWN)).depth
    row, column = np.nonzero(np.isfinite(drawn))
    height, width = depth.depth.shape
    at = depth.depth[
        np.minimum((row / DRAWN).astype(int), height - 1), np.minimum((column / DRAWN).astype(int), width - 1)
    ]
    known = np.isfinite(at) & (at > 0)
    return at[known].astype(np.float64) - drawn[row, column][known]


def confirmed(behind: FloatArray, config: FitConfig) -> float:
    """Share of depths (n,) at a surface that confirm it, less those that contradict it; -1 where there are none.

    Args:
        behind: by how much what was measured lies behind the surface, metres.
    """
    if not len(behind):
        return -1.0
    contradicted = (behind > config.contradicts) + 0.5 * (behind < -config.contradicts)
    return float(np.mean((np.abs(behind) < config.confirms) - contradicted))


def agreement(body: Body, depth: DepthImage, found: Tracked, config: FitConfig) -> float:
    """The least of three shares, of pixels that confirm where a body was found, loosely and tightly, and of firm lines.

    A flat part agrees with depth in many attitudes; wrong ones seldom have the contour as well. It is -1 where depth is
    known of too few pixels.
    """
    behind = drawn_errors(body, depth, found.world_from_object)
    if len(behind) < config.pixels:
        return -1.0
    tight = float(np.mean(np.abs(behind) < config.confirms / 2))
    return min(confirmed(behind, config), tight, found.firm / max(found.lines, 1))
