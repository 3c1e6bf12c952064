"""Changes to pictures and, exactly alike, to their labels. Never a flip: the mirror image is another object."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from random import Random

import albumentations as A
import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from multicam.image import PADDING, Letterbox
from multicam.types import FloatArray, ImageArray
from train.config import AugmentConfig
from train.samples import Labels, Picture, Region

_WHOLE = 0.99
"""Share from which a pixel shows an object and nothing else."""

_MOSAIC_SCALE = (0.5, 1.0)
"""Least and greatest zoom of the four parts of a mosaic."""

Labeller = Callable[[Picture, FloatArray, Region], Labels]
"""Labels of a picture drawn by an affine map into a region of the input."""


def letterboxed(picture: Picture, width: int, height: int, label: Labeller) -> tuple[ImageArray, Labels]:
    """The whole picture fitted into the input, as the runtime does it."""
    letterbox = Letterbox.fit(picture.image.shape[1], picture.image.shape[0], width, height)
    return letterbox.apply(picture.image), label(picture, letterbox.input_from_source, Region(0, 0, width, height))


def warped(
    picture: Picture, width: int, height: int, config: AugmentConfig, rng: np.random.Generator, label: Labeller
) -> tuple[ImageArray, Labels]:
    """One picture turned, zoomed, shifted and sheared at random."""
    whole = Region(0, 0, width, height)
    affine = random_affine(picture, whole, (width, height), config, config.scale, rng)
    return draw(picture.image, affine, whole), label(picture, affine, whole)


def mosaic(
    pictures: list[Picture],
    width: int,
    height: int,
    config: AugmentConfig,
    rng: np.random.Generator,
    label: Labeller,
) -> tuple[ImageArray, Labels]:
    """Four pictures around a random corner, each with a warp and hence a camera matrix of its own."""
    x, y = int(width * rng.uniform(0.3, 0.7)), int(height * rng.uniform(0.3, 0.7))
    regions = (
        Region(0, 0, x, y),
        Region(x, 0, width, y),
        Region(0, y, x, height),
        Region(x, y, width, height),
    )
    canvas = np.empty((height, width, 3), dtype=np.uint8)
    parts: list[Labels] = []
    for picture, region in zip(pictures, regions, strict=True):
        affine = random_affine(picture, region, (width, height), config, _MOSAIC_SCALE, rng)
        canvas[region.top : region.bottom, region.left : region.right] = draw(picture.image, affine, region)
        parts.append(label(picture, affine, region))
    return canvas, Labels.joined(parts)


def cutout(image: ImageArray, labels: Labels, donor: ImageArray, rng: np.random.Generator) -> tuple[ImageArray, Labels]:
    """Hides up to three rectangles behind pieces of another picture; keypoints under them count as hidden."""
    image, visible = image.copy(), labels.visible.copy()
    height, width = image.shape[:2]
    for _ in range(int(rng.integers(1, 4))):
        w = int(rng.uniform(0.05, 0.2) * min(width, donor.shape[1]))
        h = int(rng.uniform(0.05, 0.2) * min(height, donor.shape[0]))
        x, y = int(rng.integers(0, width - w)), int(rng.integers(0, height - h))
        u, v = int(rng.integers(0, donor.shape[1] - w)), int(rng.integers(0, donor.shape[0] - h))
        image[y : y + h, x : x + w] = donor[v : v + h, u : u + w]
        visible &= ~Region(x, y, x + w, y + h).contains(labels.keypoints)
    return image, replace(labels, visible=visible)


def with_background(image: ImageArray, alpha: FloatArray, background: ImageArray) -> ImageArray:
    """Another picture behind the objects, of which each pixel shows a share alpha (h, w), 0..1.

    A pixel at an edge is a mixture of object and old background; its object part is taken from the nearest pixel that
    shows nothing else.
    """
    behind = cv2.resize(background, (image.shape[1], image.shape[0]), interpolation=cv2.INTER_AREA)
    whole = alpha > _WHOLE
    if not whole.any():
        return behind
    nearest = distance_transform_edt(~whole, return_distances=False, return_indices=True)
    objects = image[tuple(nearest)].astype(np.float64)
    mixed = behind + alpha[..., None] * (objects - behind)
    return np.where(whole[..., None], image, np.rint(mixed).astype(np.uint8))


class Photometry:
    """Colour, blur, noise and compression, by albumentations; the same seed gives the same change."""

    def __init__(self, config: AugmentConfig) -> None:
        self._compose = A.Compose(
            [
                A.HueSaturationValue(config.hue, config.saturation, config.value, p=0.5),
                A.RandomGamma(gamma_limit=(70, 140), p=0.3),
                A.OneOf([A.GaussianBlur(blur_limit=(3, 5), p=1), A.MotionBlur(blur_limit=(3, 5), p=1)], p=config.blur),
                A.GaussNoise(std_range=(0.01, 0.04), p=config.noise),
                A.ImageCompression(quality_range=(40, 90), p=config.jpeg),
            ]
        )

    def __call__(self, image: ImageArray, rng: np.random.Generator) -> ImageArray:
        """(h, w, 3) uint8, same shape."""
        # One generator for all changes; a seed would make one for each, which takes longer than the changes.
        self._compose.set_random_state(rng, Random(int(rng.integers(2**31))))
        return self._compose(image=image)["image"]


def random_affine(
    picture: Picture,
    region: Region,
    size: tuple[int, int],
    config: AugmentConfig,
    scale: tuple[float, float],
    rng: np.random.Generator,
) -> FloatArray:
    """(3, 3) map of the picture's pixels that brings its centre near the region's centre.

    Args:
        size: width and height of the canvas, into which the picture fits at a scale of 1.
        scale: least and greatest.
    """
    height, width = picture.image.shape[:2]
    zoom = Letterbox.fit(width, height, *size).scale * rng.uniform(*scale)
    region_width, region_height = region.right - region.left, region.bottom - region.top
    angle = np.deg2rad(rng.uniform(-config.rotate_deg, config.rotate_deg))
    shear = np.tan(np.deg2rad(rng.uniform(-config.shear_deg, config.shear_deg)))
    shift = rng.uniform(-config.shift, config.shift, 2) * (region_width, region_height)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    linear = zoom * turn @ np.array([[1, shear], [0, 1]])
    source = np.array([width - 1, height - 1]) / 2
    target = np.array([region.left + region.right - 1, region.top + region.bottom - 1]) / 2 + shift
    affine = np.eye(3)
    affine[:2, :2] = linear
    affine[:2, 2] = target - linear @ source
    return affine


def draw(image: ImageArray, affine: FloatArray, region: Region) -> ImageArray:
    """The region's part of the warped picture."""
    local = affine[:2].copy()
    local[:, 2] -= (region.left, region.top)
    size = (region.right - region.left, region.bottom - region.top)
    return cv2.warpAffine(image, local, size, flags=cv2.INTER_LINEAR, borderValue=(PADDING,) * 3)
