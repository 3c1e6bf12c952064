"""Colours of an object and of what lies around it, as one camera sees them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from multicam.bundle.occlusion import Occluders
from multicam.bundle.region.compiled import count_colors
from multicam.bundle.region.config import RegionConfig
from multicam.bundle.viewpoints.model import ViewpointModel
from multicam.types import FloatArray, ImageArray

BINS = 16**3


@dataclass(frozen=True, eq=False)
class ColorModel:
    """Histograms over 16 x 16 x 16 bins of RGB, each of sum one.

    Attributes:
        inside, outside: (4096,) of the object and of its surroundings.
    """

    inside: FloatArray
    outside: FloatArray

    @classmethod
    def uniform(cls) -> ColorModel:
        """Knows nothing: every colour is as likely on the object as beside it."""
        return cls(np.full(BINS, 1 / BINS), np.full(BINS, 1 / BINS))

    @cached_property
    def posterior(self) -> NDArray[np.float32]:
        """(4096,) probability that a pixel of a colour is of the object; one half for a colour never seen."""
        total = self.inside + self.outside
        share = np.full(BINS, 0.5, dtype=np.float32)
        np.divide(self.inside, total, out=share, where=total > 0, casting="same_kind")
        return share

    def blended(self, counts: FloatArray, rate: float) -> ColorModel:
        """With a share `rate` of newly counted colours (2, 4096); a side of which none were counted stays as it is."""
        inside, outside = (
            (1 - rate) * old + (rate / new.sum()) * new if new.any() else old
            for old, new in zip((self.inside, self.outside), counts, strict=True)
        )
        return ColorModel(inside, outside)


def colors_at(
    model: ViewpointModel,
    image: ImageArray,
    camera_matrix: FloatArray,
    camera_from_object: FloatArray,
    occluders: Occluders,
    config: RegionConfig,
) -> FloatArray:
    """Counts (2, 4096) of the colours inside and outside of the contour of an object at a pose (4, 4).

    `ColorModel.uniform().blended(counts, 1.0)` is a first model; later pictures come in at `config.learning_rate`.
    """
    view = model.closest_view(camera_from_object)
    counts = np.zeros((2, BINS))
    if model.contour_length[view] > 0:
        n = config.lines
        point = model.contour_point[view, :n]
        seen = occluders.visible(point, model.contour_offset[view, :n], model.offset_step, camera_from_object)
        count_colors(
            image, camera_matrix, camera_from_object, point, model.contour_normal[view, :n],
            model.foreground[view, :n], model.background[view, :n], seen, config.nearest, config.farthest, counts,
        )  # fmt: skip
    return counts
