"""Points of a picture that can be found again in another, and which of them are the same."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from multicam.bundle.scenery.config import SceneryConfig
from multicam.geometry.camera import Camera
from multicam.types import FloatArray, ImageArray


@dataclass(frozen=True, eq=False)
class Features:
    """Points of one picture.

    Attributes:
        rays: (n, 2) x / z and y / z.
        descriptors: (n, 128) RootSIFT: Arandjelovic, Zisserman, "Three things everyone should know to improve object
            retrieval", 2012.
        pixel: size of a pixel on the plane of the rays.
    """

    rays: FloatArray
    descriptors: NDArray[np.float32]
    pixel: float


@dataclass(frozen=True, eq=False)
class Matches:
    """Rays of the same points in two pictures, (k, 2) each, the most distinct first, and their deviations (k, 2)."""

    first: FloatArray
    second: FloatArray
    std: FloatArray

    def __len__(self) -> int:
        return len(self.first)

    def chosen(self, which: NDArray[np.bool_]) -> Matches:
        """Some of them, by a mask (k,)."""
        return Matches(self.first[which], self.second[which], self.std[which])


def find_features(image: ImageArray, camera: Camera, config: SceneryConfig) -> Features:
    """The points of a picture (height, width, 3) RGB of an ideal lens."""
    sift = cv2.SIFT.create(config.features, contrastThreshold=config.contrast)
    everywhere = np.full(image.shape[:2], 255, np.uint8)
    points, found = sift.detectAndCompute(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), everywhere)
    # OpenCV gives None where there is no point.
    descriptors = np.array(found, dtype=np.float32) if points else np.zeros((0, 128), np.float32)
    pixels = np.array([point.pt for point in points], dtype=np.float64).reshape(-1, 2)
    matrix = camera.matrix
    rays = np.linalg.solve(matrix[:2, :2], (pixels - matrix[:2, 2]).T).T
    share = descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), np.float32(1e-9))
    return Features(rays, np.sqrt(share), float(1 / np.sqrt(np.abs(np.linalg.det(matrix[:2, :2])))))


def match_features(first: Features, second: Features, config: SceneryConfig) -> Matches:
    """Pairs that are each other's best, and clearly better than the next best."""
    if min(len(first.rays), len(second.rays)) < 2:
        pairs = np.zeros((0, 2), dtype=np.int64)
    else:
        # Descriptors have length 1, so distances follow from products.
        distance = np.sqrt(np.maximum(2 - 2 * first.descriptors @ second.descriptors.T, 0))
        best, back = distance.argmin(axis=1), distance.argmin(axis=0)
        rows = np.arange(len(best))
        two = np.partition(distance, 1, axis=1)[:, :2]
        ratio = two[:, 0] / np.maximum(two[:, 1], np.float32(1e-9))
        taken = np.flatnonzero((back[best] == rows) & (ratio < config.ratio))
        taken = taken[np.argsort(ratio[taken], kind="stable")]
        pairs = np.stack((rows, best), axis=1)[taken]
    std = config.std * np.array([first.pixel, second.pixel])
    return Matches(first.rays[pairs[:, 0]], second.rays[pairs[:, 1]], np.tile(std, (len(pairs), 1)))
