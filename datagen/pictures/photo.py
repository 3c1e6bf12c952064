"""From linear light to the picture a camera would store: exposure, tone curve, sensor noise."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from datagen.scenes.spec import Lens, Shot
from multicam.types import ImageArray

_MIDDLE = 0.21
"""Linear value that automatic exposure gives to the picture's typical brightness."""
_SHOULDER = 0.75
"""Display values above this are compressed instead of cut off."""


def develop(color: NDArray[np.float32], shot: Shot, rng: np.random.Generator) -> ImageArray:
    """(h, w, 3) uint8 sRGB of linear radiance; exposed automatically, then shifted by the shot's own stops."""
    color = _through_lens(color, shot.lens) * np.array(shot.white, dtype=np.float32)
    luminance = color @ np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
    # Between mean and geometric mean: neither a dark corner nor a lamp in the picture decides alone.
    typical = float(np.sqrt(np.exp(np.log(luminance + 1e-4).mean()) * (luminance.mean() + 1e-4)))
    exposed = np.maximum(color * (_MIDDLE * 2.0**shot.exposure / typical), 0)
    display = np.where(exposed > 0.0031308, 1.055 * exposed ** (1 / 2.4) - 0.055, 12.92 * exposed)
    above = display - _SHOULDER
    room = 1 - _SHOULDER
    display = np.where(above > 0, _SHOULDER + room * (1 - np.exp(-above / room)), display)
    # Photon noise grows with the root of the signal; a part of it is always there.
    deviation = shot.noise * np.sqrt(0.2 + 0.8 * display)
    noisy = display + deviation * rng.standard_normal(display.shape, dtype=np.float32)
    return np.rint(np.clip(noisy, 0, 1) * 255).astype(np.uint8)


def _through_lens(color: NDArray[np.float32], lens: Lens) -> NDArray[np.float32]:
    """Softness, and light lost towards the corners with the square of their distance from the middle."""
    if lens.softness > 0:
        color = cv2.GaussianBlur(color, (0, 0), lens.softness, borderType=cv2.BORDER_REPLICATE)
    height, width = color.shape[:2]
    y, x = np.ogrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    return color * (1 - lens.vignette * (x**2 + y**2) / 2).astype(np.float32)[..., None]
