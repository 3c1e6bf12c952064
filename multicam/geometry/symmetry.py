"""Symmetries of an object, as transforms object_from_object that leave its appearance unchanged.

T and T @ S are the same picture for every symmetry S. Definitions follow the BOP format: discrete transforms, and
rotations by any angle about an axis through an offset point; the set is every product continuous @ discrete.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from multicam.geometry import se3, so3


@dataclass(frozen=True, eq=False)
class Axis:
    """Axis of a continuous rotational symmetry: unit direction and a point on it (metres)."""

    direction: np.ndarray
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        direction = np.asarray(self.direction, dtype=np.float64)
        norm = float(np.linalg.norm(direction))
        if not norm > 0:
            raise ValueError("the direction of a symmetry axis must not be zero")
        object.__setattr__(self, "direction", direction / norm)
        object.__setattr__(self, "offset", np.asarray(self.offset, dtype=np.float64))

    def rotation(self, angle: Float64[np.ndarray, "*batch"]) -> np.ndarray:
        """Transforms (..., 4, 4) rotating about the axis by the angles (radians)."""
        rotation = so3.exp(np.asarray(angle, dtype=np.float64)[..., None] * self.direction)
        return se3.from_parts(rotation, self.offset - rotation @ self.offset)


@dataclass(frozen=True, eq=False)
class Symmetries:
    """All symmetries of one object.

    Attributes:
        discrete: (D, 4, 4) object_from_object, without the identity.
        axes: continuous axes; empty for most objects.
    """

    discrete: np.ndarray = field(default_factory=lambda: np.zeros((0, 4, 4)))
    axes: tuple[Axis, ...] = ()

    def __post_init__(self) -> None:
        discrete = np.asarray(self.discrete, dtype=np.float64).reshape(-1, 4, 4)
        r = discrete[:, :3, :3]
        if not np.allclose(r @ np.swapaxes(r, -1, -2), np.eye(3), atol=1e-3) or np.any(np.linalg.det(r) < 0):
            raise ValueError("a discrete symmetry is not a rotation (mirror images are not symmetries of rigid motion)")
        object.__setattr__(self, "discrete", discrete)

    def __bool__(self) -> bool:
        return len(self.discrete) > 0 or len(self.axes) > 0

    def transforms(self, steps: int = 64) -> Float64[np.ndarray, "count 4 4"]:
        """The set as matrices, identity first; each continuous axis in `steps` equal turns."""
        discrete = np.concatenate((np.eye(4)[None], self.discrete))
        if not self.axes:
            return discrete
        turns = 2 * np.pi * np.arange(steps) / steps
        blocks = [(axis.rotation(turns)[:, None] @ discrete).reshape(-1, 4, 4) for axis in self.axes]
        # The identity turn of every further axis repeats the discrete set.
        return np.concatenate([blocks[0]] + [block[len(discrete) :] for block in blocks[1:]])

    def closest(
        self,
        target: Float64[np.ndarray, "*#batch 4 4"],
        source: Float64[np.ndarray, "*#batch 4 4"],
        extent: float,
    ) -> Float64[np.ndarray, "*batch 4 4"]:
        """The symmetry S for which source @ S comes closest to target.

        Closeness is |t|^2 / extent^2 + |R - R'|_F^2 / 2, with `extent` the object's radius in metres, so that a
        radian counts as much as the path of the rim. The angle about a continuous axis is found in closed form
        for every discrete symmetry.

        Returns:
            (..., 4, 4) object_from_object.
        """
        candidates = np.concatenate((np.eye(4)[None], self.discrete))
        relative = se3.inverse(source) @ target
        options = np.broadcast_to(candidates, (*relative.shape[:-2], *candidates.shape))
        turned = [options] + [
            axis.rotation(_best_turn(axis, relative, options, extent)) @ options for axis in self.axes
        ]
        stacked = np.concatenate(turned, axis=-3)
        difference = se3.inverse(stacked) @ relative[..., None, :, :]
        rotation_cost = 3 - np.trace(difference[..., :3, :3], axis1=-2, axis2=-1)
        cost = rotation_cost + np.sum(difference[..., :3, 3] ** 2, axis=-1) / extent**2
        best = np.argmin(cost, axis=-1)[..., None, None, None]
        return np.take_along_axis(stacked, best, axis=-3)[..., 0, :, :]


def _best_turn(axis: Axis, relative: np.ndarray, discrete: np.ndarray, extent: float) -> np.ndarray:
    """The angle a at which axis.rotation(a) @ discrete comes closest to the relative pose."""
    p, q = relative[..., None, :3, 3] - axis.offset, axis.offset - discrete[..., :3, 3]
    # With R = R(a) the cost is a constant - <R, M>: the translation left over is R'p + q, up to a rotation.
    rotation = relative[..., None, :3, :3] @ np.swapaxes(discrete[..., :3, :3], -1, -2)
    rest = rotation - 2 / extent**2 * p[..., :, None] * q[..., None, :]
    n = axis.direction
    trace = np.trace(rest, axis1=-2, axis2=-1)
    along = np.einsum("i,...ij,j->...", n, rest, n)
    # <R(a), M> = cos a (tr M - n'Mn) + sin a (n . 2 vee(M)) + n'Mn.
    return np.arctan2(2 * so3.vee(rest) @ n, trace - along)


def symmetric_distance(
    a: Float64[np.ndarray, "*#batch 4 4"],
    b: Float64[np.ndarray, "*#batch 4 4"],
    symmetries: Float64[np.ndarray, "count 4 4"],
    points: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, "*batch"]:
    """min over S of the mean distance between a @ S and b applied to the points, metres (CosyPose)."""
    moved = se3.act(a[..., None, :, :] @ symmetries, points)
    distance = np.linalg.norm(moved - se3.act(b, points)[..., None, :, :], axis=-1).mean(-1)
    return np.asarray(distance.min(-1))
