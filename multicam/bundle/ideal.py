"""What lines and points need of a picture."""

from __future__ import annotations

import numpy as np

from multicam.geometry.camera import Camera
from multicam.types import ImageArray


def require_ideal(image: ImageArray, camera: Camera) -> None:
    """Accepts a picture (height, width, 3) RGB of an ideal lens.

    Raises:
        ValueError: it is not what its camera says, or is distorted.
    """
    expected = (camera.height, camera.width, 3)
    if image.shape != expected or image.dtype != np.uint8:
        raise ValueError(f"image is {image.dtype} {image.shape}, its camera says uint8 {expected}")
    if camera.distortion:
        raise ValueError("lines are straight under an ideal lens only; undistort the picture first")
