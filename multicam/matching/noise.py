"""How uncertain a pose is that comes without a covariance: from the object's size, its distance and the focal length.

The model is that of an outline measured with a constant error in the image. Seen from the camera, a point of the object
at distance z is known to sigma = pixel_std z / f across the line of sight, and `depth_ratio` times worse along it. The
mean over the corners of the object's box gives the information about its pose (docs/registration.md, "Noise").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.dataset.objects import ObjectModel
from multicam.geometry import se3, so3
from multicam.matching.linear import inverse
from multicam.matching.symmetry import axis_twist
from multicam.types import FloatArray

FREE_TURN_VARIANCE = np.pi**2 / 3
"""Variance of an angle spread evenly over the circle (rad^2): what is known of the turn about a symmetry axis."""


@dataclass(frozen=True)
class NoiseConfig:
    """Noise of estimates that state none; one set of values for all data."""

    pixel_std: float = 2.5
    """Error of an object's outline in the image, pixels; covers the network, the model and the calibration."""
    assumed_focal: float = 1000.0
    """Focal length, pixels, of a view whose camera matrix is unknown; only the size of the noise depends on it."""
    depth_ratio: float = 4.0
    """How many times worse a point is known along the line of sight than across it."""

    def __post_init__(self) -> None:
        if min(self.pixel_std, self.assumed_focal, self.depth_ratio) <= 0:
            raise ValueError("pixel_std, assumed_focal and depth_ratio must be positive")


def geometric_covariance(
    camera_from_object: FloatArray, corners: FloatArray, focal: FloatArray, config: NoiseConfig
) -> FloatArray:
    """Covariance of the right perturbation of poses that state none.

    Args:
        camera_from_object: (n, 4, 4).
        corners: (n, 8, 3) of the object's box, object frame, metres.
        focal: (n,) pixels.

    Returns:
        (n, 6, 6), [rotation rad; translation m].
    """
    rotation = camera_from_object[:, :3, :3]
    centre = se3.act(camera_from_object, corners.mean(axis=1)[:, None, :])[:, 0]
    distance = np.linalg.norm(centre, axis=-1)
    ray = (np.swapaxes(rotation, -1, -2) @ (centre / distance[:, None])[..., None])[..., 0]
    lateral = (config.pixel_std * distance / focal)[:, None, None]
    along = ray[:, :, None] * ray[:, None, :]
    weight = (np.eye(3) - along + along / config.depth_ratio**2) / lateral**2
    # A corner X moves by [-hat(X), I] xi; the mean over corners of its information.
    lever = np.concatenate((-so3.hat(corners), np.broadcast_to(np.eye(3), (*corners.shape, 3))), axis=-1)
    information = (np.swapaxes(lever, -1, -2) @ weight[:, None] @ lever).mean(axis=1)
    return inverse(information)


def free_turns(model: ObjectModel) -> FloatArray:
    """(6, 6) variance that the object's continuous symmetries leave open, in its right tangent; zero for most."""
    covariance = np.zeros((6, 6))
    for axis in model.symmetries.axes:
        twist = axis_twist(axis)
        covariance += FREE_TURN_VARIANCE * np.outer(twist, twist)
    return covariance
