"""Letterbox: fit an image into the network's input, and lead pixels back; shared by training and inference."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64

from multicam.types import FloatArray, ImageArray

PADDING = 114
"""Grey value of the border, as in YOLOX."""


@dataclass(frozen=True)
class Letterbox:
    """Uniform scaling followed by a shift that centres the image.

    Maps source pixel p to scale * (p + 0.5) - 0.5 + offset, so pixel centres stay at integers.
    """

    scale: float
    offset_x: int
    offset_y: int
    width: int
    height: int

    @classmethod
    def fit(cls, source_width: int, source_height: int, width: int, height: int) -> Letterbox:
        """The letterbox that fits a source image into width x height, centred."""
        scale = min(width / source_width, height / source_height)
        inner_w, inner_h = round(source_width * scale), round(source_height * scale)
        return cls(scale, (width - inner_w) // 2, (height - inner_h) // 2, width, height)

    @property
    def input_from_source(self) -> FloatArray:
        """(3, 3) affine map of pixels."""
        shift = (self.scale - 1) / 2
        return np.array([[self.scale, 0, shift + self.offset_x], [0, self.scale, shift + self.offset_y], [0, 0, 1.0]])

    def apply(self, image: ImageArray) -> ImageArray:
        """Warps (h, w, 3) uint8 into (height, width, 3) with a grey border."""
        mode = cv2.INTER_AREA if self.scale < 1 else cv2.INTER_LINEAR
        # Given the factor, OpenCV keeps it; given a size, it would stretch by up to half a pixel to fill it.
        inner = image if self.scale == 1 else cv2.resize(image, None, fx=self.scale, fy=self.scale, interpolation=mode)
        inner_h, inner_w = inner.shape[:2]
        out = np.full((self.height, self.width, 3), PADDING, dtype=np.uint8)
        out[self.offset_y : self.offset_y + inner_h, self.offset_x : self.offset_x + inner_w] = inner
        return out

    def to_source(self, pixels: Float64[np.ndarray, "*batch 2"]) -> Float64[np.ndarray, "*batch 2"]:
        """Pixels of the network's input as pixels of the source image."""
        shift = np.array([self.offset_x, self.offset_y]) + (self.scale - 1) / 2
        return (pixels - shift) / self.scale

    def to_input(self, pixels: Float64[np.ndarray, "*batch 2"]) -> Float64[np.ndarray, "*batch 2"]:
        """Pixels of the source image as pixels of the network's input."""
        return pixels * self.scale + np.array([self.offset_x, self.offset_y]) + (self.scale - 1) / 2
