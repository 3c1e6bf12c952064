"""Correspondence lines of one object in one picture, at one pose."""

from __future__ import annotations

import numpy as np

from multicam.bundle.groups import RecordArray
from multicam.bundle.occlusion import Occluders
from multicam.bundle.region.colors import ColorModel
from multicam.bundle.region.compiled import LINE, search_lines
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
) -> LineArray:
    """Lines across the contour of an object at a pose (4, 4), each with the posterior of where the contour lies.

    Left out are lines that do not fit into the picture, that are hidden, and those near which the silhouette is too
    thin to tell one side from the other at the scale of this search. There may be none.

    Args:
        image: (height, width, 3) RGB, without distortion.
        search: number of the search, from 0, by which scale and deviation advance.
    """
    view = model.closest_view(camera_from_object)
    if model.contour_length[view] == 0:
        return np.empty(0, LINE)
    n = config.lines
    point = model.contour_point[view, :n]
    seen = occluders.visible(point, model.contour_offset[view, :n], model.offset_step, camera_from_object)
    lines = np.empty(len(point), LINE)
    count = search_lines(
        image, camera_matrix, camera_from_object, colors.posterior, point, model.contour_normal[view, :n],
        model.foreground[view, :n], model.background[view, :n], seen,
        config.scale(search), config.deviation(search), config.clear, lines,
    )  # fmt: skip
    return lines[:count]
