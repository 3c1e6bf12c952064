"""What the agreement of many estimates says of their noise: per class, in the directions of the view.

A noise model multiplies the stated or geometric standard deviations of an estimate, separately for its attitude, for
its centre across the line of sight and along it, and corrects a depth that is always too far or too near. How it is
learnt: docs/registration.md, "Noise from agreement".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from multicam.geometry import so3
from multicam.matching.arrays import IntArray
from multicam.matching.linear import apply, congruent
from multicam.types import FloatArray

BLOCKS = (slice(0, 3), slice(3, 5), slice(5, 6))
"""Attitude, lateral and depth in the coordinates of `viewing_axes`."""


@dataclass(frozen=True)
class ClassNoise:
    """Noise of the estimates of one class, as factors on the standard deviations without it."""

    attitude: float = 1.0
    """Of the attitude."""
    lateral: float = 1.0
    """Of the centre across the line of sight."""
    depth: float = 1.0
    """Of the centre along it."""
    too_far: float = 0.0
    """How much too far estimates are on average, logarithm of the ratio of depths."""

    def __post_init__(self) -> None:
        values = (self.attitude, self.lateral, self.depth, self.too_far)
        if not all(np.isfinite(values)) or min(values[:3]) <= 0:
            raise ValueError(f"noise factors must be positive and finite; they are {values}")


@dataclass(frozen=True)
class NoiseModel:
    """Noise of every class."""

    classes: Mapping[int, ClassNoise] = field(default_factory=dict[int, ClassNoise])
    """By obj_id."""
    default: ClassNoise = ClassNoise()
    """Of all others."""
    kinship: float = 1.0
    """How much larger the variances of errors in unlike views are than these factors say. Estimates of an object from
    like directions err alike: they agree better than they are right."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.kinship) and self.kinship >= 1):
            raise ValueError(f"kinship must be at least 1; it is {self.kinship}")

    def of(self, obj_id: int) -> ClassNoise:
        """The noise of a class."""
        return self.classes.get(obj_id, self.default)

    def widened(self, variance: float) -> NoiseModel:
        """All variances grown by a factor."""

        def wider(noise: ClassNoise) -> ClassNoise:
            factors = (np.sqrt(variance) * f for f in (noise.attitude, noise.lateral, noise.depth))
            return ClassNoise(*map(float, factors), too_far=noise.too_far)

        return NoiseModel({o: wider(noise) for o, noise in self.classes.items()}, wider(self.default), self.kinship)

    def factors(self, obj_id: IntArray) -> FloatArray:
        """(n, 6) factors on the standard deviations in the coordinates of `viewing_axes`."""
        rows = [self.of(int(o)) for o in obj_id]
        return np.array([[n.attitude] * 3 + [n.lateral] * 2 + [n.depth] for n in rows]).reshape(-1, 6)

    def apply(
        self, obj_id: IntArray, camera_from_object: FloatArray, centre: FloatArray, covariance: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Poses (n, 4, 4) with their depth corrected, and covariances (n, 6, 6) of their right perturbation scaled.

        Args:
            obj_id: (n,).
            camera_from_object: (n, 4, 4).
            centre: (n, 3) of the objects, object frame.
            covariance: (n, 6, 6).
        """
        too_far = np.array([self.of(int(o)).too_far for o in obj_id]).reshape(-1)
        poses = camera_from_object.copy()
        poses[:, :3, 3] += np.expm1(-too_far)[:, None] * centre_in_camera(camera_from_object, centre)
        forth = viewing_axes(poses, centre)
        scale = from_viewing_axes(forth) @ (self.factors(obj_id)[:, :, None] * forth)
        return poses, self.kinship * congruent(scale, covariance)


def centre_in_camera(camera_from_object: FloatArray, centre: FloatArray) -> FloatArray:
    """(n, 3) the objects' centres (n, 3) seen from the cameras."""
    return apply(camera_from_object[:, :3, :3], centre) + camera_from_object[:, :3, 3]


def viewing_axes(camera_from_object: FloatArray, centre: FloatArray) -> FloatArray:
    """(n, 6, 6) maps of a right tangent to [attitude; motion of the centre across and along the line of sight].

    With c the centre, R the attitude and Q = (rows) two directions across the line of sight and the line itself:
    [Q R, 0; -Q R hat(c), Q R].
    """
    ray = centre_in_camera(camera_from_object, centre)
    ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    # Any vector that is not parallel to the ray gives a frame; the choice within the image plane does not matter.
    helper = np.where(np.abs(ray[:, :1]) < 0.9, np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]]))
    across = so3.cross(helper, ray)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    turn = np.stack((across, so3.cross(ray, across), ray), axis=1) @ camera_from_object[:, :3, :3]
    axes = np.zeros((len(turn), 6, 6))
    axes[:, :3, :3] = axes[:, 3:, 3:] = turn
    axes[:, 3:, :3] = -turn @ so3.hat(centre)
    return axes


def from_viewing_axes(axes: FloatArray) -> FloatArray:
    """Inverses of such maps (n, 6, 6): each of their blocks transposed, [R'Q', 0; hat(c) R'Q', R'Q']."""
    blocks = axes.reshape(-1, 2, 3, 2, 3)
    return np.swapaxes(blocks, 2, 4).reshape(axes.shape)
