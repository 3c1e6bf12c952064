"""Changes to pictures and, exactly alike, to their labels. Never a flip: the mirror image is another object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from random import Random
from typing import NamedTuple

import albumentations as A
import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from multicam.image import PADDING, Letterbox
from multicam.types import FloatArray, ImageArray
from train.config import AugmentConfig
from train.samples import Labels, Picture, Region

_WHOLE = 0.99
"""Share from which a pixel shows an object and nothing else."""

_LEAST_PIECE = 0.1
"""Share of a picture's sides that a piece of bare ground has at least."""
_TRIES = 20
"""How many pieces are looked at before a picture counts as full of objects."""

Labeller = Callable[[Picture, FloatArray, Region], Labels]
"""Labels of a picture drawn by an affine map into a region of the input."""


class Zoom(NamedTuple):
    """Pixels into which a picture is fitted, and by how much, at least and at most, it is zoomed then."""

    width: int
    height: int
    least: float
    greatest: float


@dataclass(frozen=True, eq=False)
class Canvas:
    """What the network will see.

    Attributes:
        image: (h, w, 3).
        instances: (h, w) place (`Labels.places`), from 1, of the instance that a pixel shows, 0 for none; None if the
            pictures do not know theirs.
    """

    image: ImageArray
    labels: Labels
    instances: NDArray[np.uint16] | None


def letterboxed(picture: Picture, width: int, height: int, label: Labeller) -> tuple[ImageArray, Labels]:
    """The whole picture fitted into the input, as the runtime does it."""
    letterbox = Letterbox.fit(picture.image.shape[1], picture.image.shape[0], width, height)
    return letterbox.apply(picture.image), label(picture, letterbox.input_from_source, Region(0, 0, width, height))


def warped(
    picture: Picture, width: int, height: int, config: AugmentConfig, rng: np.random.Generator, label: Labeller
) -> Canvas:
    """One picture turned, zoomed, shifted and sheared at random."""
    whole = Region(0, 0, width, height)
    affine = random_affine(picture, whole, Zoom(width, height, *config.scale), config, rng)
    return Canvas(draw(picture.image, affine, whole), label(picture, affine, whole), _instances(picture, affine, whole))


def mosaic(
    pictures: Sequence[Picture],
    width: int,
    height: int,
    zoom: Zoom,
    config: AugmentConfig,
    rng: np.random.Generator,
    label: Labeller,
) -> Canvas:
    """Four pictures, one of them with objects at least, around a random corner.

    Each has a warp and hence a camera matrix of its own.
    """
    x, y = int(width * rng.uniform(0.3, 0.7)), int(height * rng.uniform(0.3, 0.7))
    regions = (
        Region(0, 0, x, y),
        Region(x, 0, width, y),
        Region(0, y, x, height),
        Region(x, y, width, height),
    )
    image = np.empty((height, width, 3), dtype=np.uint8)
    instances = np.zeros((height, width), dtype=np.uint16)
    parts: list[Labels] = []
    before = 0
    for picture, region in zip(pictures, regions, strict=True):
        affine = random_affine(picture, region, zoom, config, rng)
        part = np.s_[region.top : region.bottom, region.left : region.right]
        image[part] = draw(picture.image, affine, region)
        shown = _instances(picture, affine, region)
        if shown is not None:
            instances[part] = np.where(shown > 0, shown + before, 0)
        if picture.record.instances:
            labels = label(picture, affine, region)
            parts.append(replace(labels, places=labels.places + before))
            before += len(picture.record.instances)
    known = all(picture.instances is not None for picture in pictures)
    return Canvas(image, Labels.joined(parts), instances if known else None)


def bare_ground(picture: Picture, rng: np.random.Generator) -> Picture | None:
    """A piece of a picture that shows no object, as a picture of its own; None if none is found soon."""
    assert picture.instances is not None
    occupied = cv2.integral((picture.instances > 0).astype(np.uint8))
    height, width = picture.instances.shape
    for _ in range(_TRIES):
        share = np.exp(rng.uniform(np.log(_LEAST_PIECE), 0.0))
        h, w = round(share * height), round(share * width)
        y, x = int(rng.integers(height - h + 1)), int(rng.integers(width - w + 1))
        if occupied[y + h, x + w] - occupied[y, x + w] - occupied[y + h, x] + occupied[y, x] == 0:
            part = np.s_[y : y + h, x : x + w]
            empty = replace(picture.record, instances=())
            return Picture(empty, picture.image[part], None, picture.instances[part])
    return None


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
    out = np.where(whole[..., None], image, behind)
    edge = ~whole & (alpha > 0)
    objects = image[tuple(nearest[:, edge])].astype(np.float64)
    out[edge] = np.rint(behind[edge] + alpha[edge, None] * (objects - behind[edge]))
    return out


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
    zoom: Zoom,
    config: AugmentConfig,
    rng: np.random.Generator,
) -> FloatArray:
    """(3, 3) map of the picture's pixels that brings its centre near the region's centre."""
    height, width = picture.image.shape[:2]
    scale = Letterbox.fit(width, height, zoom.width, zoom.height).scale * rng.uniform(zoom.least, zoom.greatest)
    region_width, region_height = region.right - region.left, region.bottom - region.top
    angle = np.deg2rad(rng.uniform(-config.rotate_deg, config.rotate_deg))
    shear = np.tan(np.deg2rad(rng.uniform(-config.shear_deg, config.shear_deg)))
    shift = rng.uniform(-config.shift, config.shift, 2) * (region_width, region_height)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    linear = scale * turn @ np.array([[1, shear], [0, 1]])
    source = np.array([width - 1, height - 1]) / 2
    target = np.array([region.left + region.right - 1, region.top + region.bottom - 1]) / 2 + shift
    affine = np.eye(3)
    affine[:2, :2] = linear
    affine[:2, 2] = target - linear @ source
    return affine


def draw(image: ImageArray, affine: FloatArray, region: Region) -> ImageArray:
    """The region's part of the warped picture."""
    return cv2.warpAffine(image, *_within(affine, region), flags=cv2.INTER_LINEAR, borderValue=(PADDING,) * 3)


def _instances(picture: Picture, affine: FloatArray, region: Region) -> NDArray[np.uint16] | None:
    """Which instance each pixel of the region shows, as `Picture.instances`."""
    if picture.instances is None:
        return None
    return cv2.warpAffine(picture.instances, *_within(affine, region), flags=cv2.INTER_NEAREST).astype(np.uint16)


def _within(affine: FloatArray, region: Region) -> tuple[FloatArray, tuple[int, int]]:
    """The map (2, 3) to pixels of the region, and the region's width and height."""
    local = affine[:2].copy()
    local[:, 2] -= (region.left, region.top)
    return local, (region.right - region.left, region.bottom - region.top)
