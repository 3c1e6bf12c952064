# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; generate, which wraps these kernels, is strict.
"""Depth offsets: how much nearer the object comes within growing circles around a point. Compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from multicam.bundle.viewpoints.model import Float32Array
from multicam.bundle.viewpoints.picture import Picture

WIDEST = 60
"""Radius, in cells, of the largest circle. It cuts circles off only where all of the picture lies within it."""

FINENESS = 16
"""Radii are rounded to this fraction of a cell."""

FEWEST = 40
"""Least number of cells along the longer side of a picture, where the object is smaller than as many steps."""


class Circles:
    """The cells of circles about a cell of a grid, nearest first; for pictures of one size.

    Attributes:
        side: pixels of the longer side of the pictures.
        stride: width of the grid, which is padded by the largest circle.
        place: (n,) flat offset of each cell.
        within: (r,) number of cells that are nearer than r / FINENESS cells.
    """

    def __init__(self, side: int) -> None:
        self.side = side
        self.stride = side + 2 * WIDEST
        y, x = np.mgrid[-WIDEST : WIDEST + 1, -WIDEST : WIDEST + 1]
        squared = (x**2 + y**2).ravel()
        order = np.argsort(squared, kind="stable")[: np.count_nonzero(squared < WIDEST**2)]
        self.place = (y * self.stride + x).ravel()[order]
        self.within = np.searchsorted(squared[order], (np.arange(WIDEST * FINENESS + 1) / FINENESS) ** 2)

    def over(self, picture: Picture, step: float) -> DepthOffsets:
        """Prepares a picture for radii that are multiples of `step`, metres."""
        pixels = step * picture.view.focal
        cell = max(1.0, min(pixels / picture.view.distance, self.side / FEWEST))
        return DepthOffsets(self, picture.inverse_depth, cell, pixels)


class DepthOffsets:
    """Depth offsets of the pixels of one picture."""

    def __init__(self, circles: Circles, inverse_depth: Float32Array, cell: float, step: float) -> None:
        self._circles, self._inverse_depth, self._cell, self._step = circles, inverse_depth, cell, step
        self._grid = pool(inverse_depth, cell, circles.stride)

    def measure(self, pixel, offset) -> None:
        """Writes the offsets (N, K) of pixels x, y (N, 2) of the silhouette."""
        circles = self._circles
        measure(
            pixel, self._inverse_depth, self._grid, self._cell, self._step,
            circles.stride, circles.place, circles.within, offset,
        )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def pool(inverse_depth, cell, stride):
    """Greatest 1/z of each cell, `cell` pixels wide, in the middle of a flat grid of zeros with rows of `stride`."""
    height, width = inverse_depth.shape
    grid = np.zeros((int((height - 1) / cell) + 1 + 2 * WIDEST, stride), np.float32)
    for y in range(height):
        row = grid[int(y / cell) + WIDEST]
        for x in range(width):
            column = int(x / cell) + WIDEST
            row[column] = max(row[column], inverse_depth[y, x])
    return grid.ravel()


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"nnan", "nsz", "reassoc"})
def measure(pixel, inverse_depth, grid, cell, step, stride, place, within, offset):
    """Writes depth offsets (N, K) of the pixels (N, 2).

    Args:
        grid: of `pool`.
        step: pixels of a step of the radius at 1/z = 1.
        stride, place, within: of Circles.
    """
    nearest = inverse_depth.max()
    for i in range(len(pixel)):
        x, y = pixel[i]
        here = inverse_depth[y, x]
        base = (int(y / cell) + WIDEST) * stride + int(x / cell) + WIDEST
        radius = step * here / cell * FINENESS
        greatest, done = here, 0
        for k in range(offset.shape[1]):
            until = within[min(int((k + 1) * radius), len(within) - 1)]
            if greatest < nearest:
                for e in range(done, until):
                    greatest = max(greatest, grid[base + place[e]])
                done = until
            offset[i, k] = 1 / here - 1 / greatest
