"""Pictures whose content is known to a hundredth of a pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from multicam.types import ImageArray


def blob_image(width: int, height: int, centre: NDArray[np.float64], sigma: float = 4.0) -> ImageArray:
    """(height, width, 3) black picture with one bright Gaussian blob; pixel (0, 0) is a pixel's centre."""
    y, x = np.mgrid[:height, :width]
    grey = 250 * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * sigma**2))
    return np.repeat(np.rint(grey).astype(np.uint8)[..., None], 3, axis=-1)


def blob_centre(image: ImageArray) -> NDArray[np.float64]:
    """(2,) centre of mass of the grey values, x y in pixels."""
    weight = image[..., 0].astype(np.float64)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


def noise_image(width: int, height: int, rng: np.random.Generator) -> ImageArray:
    """(height, width, 3) smooth random colours, which JPEG keeps closely."""
    y, x = np.mgrid[:height, :width] / max(width, height)
    waves = [np.sin(rng.uniform(2, 9) * x + rng.uniform(2, 9) * y + rng.uniform(0, 6)) for _ in range(3)]
    return np.rint(127 + 120 * np.stack(waves, axis=-1)).astype(np.uint8)
