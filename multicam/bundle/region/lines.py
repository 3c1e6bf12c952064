"""Correspondence lines of one object in one picture, at one pose."""

from __future__ import annotations

import numpy as np

from multicam.bundle.groups import RecordArray
from multicam.bundle.occlusion import Occluders
from multicam.bundle.region.colors import ColorModel
from multicam.bundle.region.compiled import LINE, search_contour
from multicam.bundle.region.config import RegionConfig
from multicam.bundle.viewpoints.model import ViewpointModel
from multicam.types import FloatArray, ImageArray

LineArray = RecordArray
"""(n,) records of `compiled.LINE`."""


def find_lines(
    model: ViewpointModel,
    image: ImageArray,
    camera_matrix: FloatArray,
    camera_from_object: FloatArray,
    colors: ColorModel,
    occluders: Occluders,
    search: int,
    config: RegionConfig,
    finer: bool = False,
) -> LineArray:
    """Lines across the contour of an object at a pose (4, 4), each with the posterior of where the contour lies.

    Left out are lines that do not fit into the picture, that are hidden, and those near which the silhouette is too
    thin to tell one side from the other at the scale of this search. There may be none.

    Args:
        image: (height, width, 3) RGB, without distortion.
        search: number of the search, from 0, by which scale and deviation advance.
        finer: whether, where the object is too thin for half of the lines, those of the next finer scale are taken.
    """
    lines = np.empty(min(config.lines, model.contour_point.shape[1]), LINE)
    searches = range(search, max(search + 1, len(config.scales) if finer else 0))
    count = search_contour(
        image, camera_matrix, camera_from_object, colors.posterior, *occluders.packed,
        model.direction, model.contour_length, model.contour_point, model.contour_normal,
        model.foreground, model.background, model.contour_offset, model.offset_step,
        np.array([config.scale(each) for each in searches]), np.array([config.deviation(each) for each in searches]),
        config.clear, lines,
    )  # fmt: skip
    return lines[:count]
