"""Objects cut out of other pictures and pasted over a picture: other neighbours, grounds, light and occlusions.

One render serves many times this way (Dwibedi et al. 2017, "Cut, paste and learn"). Each pasted object is drawn by an
affine map M of its own, so its labels are exact under K' = M K.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from multicam.types import FloatArray, ImageArray
from train.augment import Canvas, Labeller, Zoom, random_affine
from train.config import AugmentConfig
from train.samples import Labels, Picture, Region

LEAST_SEEN = 0.5
"""Objects seen less in their own picture are not cut out: a pasted half would look like an object of its own."""
_MARGIN = 2
_WHOLLY = 0.5
"""Share from which a cutting hides what is behind it."""
_GAIN, _GAMMA, _TINT = 0.3, 0.2, 0.06
"""Standard deviations of the logarithms of brightness, contrast and colour of a pasted object."""


@dataclass(frozen=True, eq=False)
class Cutting:
    """One instance of a picture.

    Attributes:
        place: in the picture's record.
        corner: (2,) pixel of the picture that is the patch's first.
        patch: (h, w, 3) uint8, the instance and a margin; coverage: (h, w) float32, the share of each pixel it covers.
    """

    picture: Picture
    place: int
    corner: FloatArray
    patch: ImageArray
    coverage: NDArray[np.float32]

    @classmethod
    def of(cls, picture: Picture, place: int) -> Cutting:
        """Cuts out an instance of a picture that has its instances.

        Pixels at an outline are mixtures with the old background, so the outline is drawn in by half a pixel.
        """
        assert picture.instances is not None
        mask = (picture.instances == place + 1).astype(np.float32)
        x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
        left, top = max(x - _MARGIN, 0), max(y - _MARGIN, 0)
        part = np.s_[top : y + height + _MARGIN, left : x + width + _MARGIN]
        inner = np.clip(2 * cv2.blur(mask, (3, 3), borderType=cv2.BORDER_REPLICATE)[part] - 1, 0, 1)
        return cls(picture, place, np.array([left, top], dtype=np.float64), picture.image[part], inner)

    @property
    def middle(self) -> FloatArray:
        """(2,) of the patch, pixels of the picture."""
        return self.corner + (np.array(self.patch.shape[1::-1]) - 1) / 2


def draw_cutting(picture: Picture, rng: np.random.Generator) -> Cutting | None:
    """An instance of the picture that is worth cutting out, if there is one."""
    worth = [
        place
        for place, instance in enumerate(picture.record.instances)
        if picture.shown[place + 1] and (instance.visible_fraction is None or instance.visible_fraction >= LEAST_SEEN)
    ]
    return Cutting.of(picture, int(rng.choice(worth))) if worth else None


class Collage:
    """A picture on which cuttings are pasted one after the other, each in front of what is there."""

    def __init__(self, canvas: Canvas) -> None:
        """Starts with a canvas that knows its instances."""
        assert canvas.instances is not None
        self.image, self._instances = canvas.image.copy(), canvas.instances
        self._labels = [canvas.labels]
        self._level = np.zeros(canvas.image.shape[:2], dtype=np.uint8)
        self._drawn = [self._shown()]

    def paste(self, cutting: Cutting, affine: FloatArray, label: Labeller, rng: np.random.Generator) -> None:
        """Draws a cutting by the map `affine` (3, 3) from its picture's pixels to the canvas, in a light of its own."""
        height, width = self.image.shape[:2]
        local = affine.copy()
        local[:2, 2] += affine[:2, :2] @ cutting.corner
        ends = np.array([(x, y) for x in (0, cutting.patch.shape[1]) for y in (0, cutting.patch.shape[0])])
        reached = ends @ local[:2, :2].T + local[:2, 2]
        left, top = np.maximum(np.floor(reached.min(axis=0)), 0).astype(int)
        right, bottom = np.minimum(np.ceil(reached.max(axis=0)) + 1, (width, height)).astype(int)
        if right <= left or bottom <= top:
            return
        local[:2, 2] -= (left, top)
        size, part = (int(right - left), int(bottom - top)), np.s_[top:bottom, left:right]
        patch = cv2.warpAffine(_relit(cutting.patch, rng), local[:2], size, borderMode=cv2.BORDER_REPLICATE)
        alpha = cv2.warpAffine(cutting.coverage, local[:2], size)
        behind = self.image[part].astype(np.float32)
        self.image[part] = np.rint(behind + alpha[..., None] * (patch - behind))
        over = alpha > _WHOLLY
        self._level[part][over] = len(self._labels)
        self._drawn.append(np.array([np.count_nonzero(over)]))
        record = cutting.picture.record
        alone = replace(record, instances=(record.instances[cutting.place],))
        self._labels.append(label(replace(cutting.picture, record=alone), affine, Region(0, 0, width, height)))

    def labels(self, minimum_visible: float) -> Labels:
        """Of all that is on the canvas; what later cuttings hide is hidden."""
        parts: list[Labels] = []
        for level, labels in enumerate(self._labels):
            left = self._shown() if level == 0 else np.array([np.count_nonzero(self._level == level)])
            seen = labels.seen * left / np.maximum(self._drawn[level], 1)
            visible = labels.visible & ~self._covered(labels.keypoints, level)
            parts.append(replace(labels, visible=visible, seen=seen, ignored=seen < minimum_visible))
        return Labels.joined(parts)

    def _shown(self) -> NDArray[np.int64]:
        """(G,) pixels of the canvas's own instances over which nothing is pasted."""
        number = self._labels[0].places + 1
        return np.bincount(self._instances[self._level == 0], minlength=number.max() + 1)[number]

    def _covered(self, keypoints: FloatArray, level: int) -> NDArray[np.bool_]:
        """Whether something pasted later lies over pixels (..., 2)."""
        height, width = self._level.shape
        pixels = np.rint(keypoints).astype(int)
        inside = Region(0, 0, width, height).contains(keypoints)
        x, y = np.where(inside[..., None], pixels, 0).transpose(2, 0, 1)
        return inside & (self._level[y, x] > level)


def pasted(
    canvas: Canvas,
    cuttings: Sequence[Cutting],
    zoom: Zoom,
    config: AugmentConfig,
    rng: np.random.Generator,
    label: Labeller,
    minimum_visible: float,
) -> tuple[ImageArray, Labels]:
    """A canvas with cuttings on it, each turned and zoomed at random and anywhere."""
    height, width = canvas.image.shape[:2]
    collage = Collage(canvas)
    for cutting in cuttings:
        affine = random_affine(cutting.picture, Region(0, 0, width, height), zoom, config, rng)
        affine[:2, 2] += rng.uniform(0, 1, 2) * (width, height) - (affine @ (*cutting.middle, 1.0))[:2]
        collage.paste(cutting, affine, label, rng)
    return collage.image, collage.labels(minimum_visible)


def _relit(patch: ImageArray, rng: np.random.Generator) -> ImageArray:
    """The same under another light: brighter or darker, harder or softer, warmer or colder."""
    gain = np.exp(rng.normal(0, _GAIN) + rng.normal(0, _TINT, 3))
    values = (np.arange(256)[:, None] / 255) ** np.exp(rng.normal(0, _GAMMA)) * gain
    table = np.rint(np.minimum(255 * values, 255)).astype(np.uint8)
    return cv2.LUT(patch, table[None])
