"""Measured points near the surface of one object in one depth picture, at one pose."""

from __future__ import annotations

import numpy as np

from multicam.bundle.depth.compiled import PAIR, search_surface
from multicam.bundle.depth.config import DepthConfig
from multicam.bundle.depth_image import DepthImage
from multicam.bundle.groups import RecordArray
from multicam.bundle.occlusion import Occluders
from multicam.bundle.viewpoints.model import ViewpointModel
from multicam.types import FloatArray

PairArray = RecordArray
"""(n,) records of `compiled.PAIR`."""


def find_points(
    model: ViewpointModel,
    image: DepthImage,
    camera_from_object: FloatArray,
    occluders: Occluders,
    search: int,
    config: DepthConfig,
) -> PairArray:
    """The nearest measured point to each visible point of the surface of an object at a pose (4, 4).

    Left out are points that are hidden, outside the picture, or without a measured point within the radius of this
    search. There may be none.

    Args:
        search: number of the search, from 0, by which radius and deviation advance.
    """
    pairs = np.empty(min(config.points, model.surface_point.shape[1]), PAIR)
    count = search_surface(
        image.packed, camera_from_object, *occluders.packed, model.direction, model.surface_area,
        model.surface_point, model.surface_normal, model.surface_offset, model.offset_step,
        config.radius(search), config.spacing(search), config.deviation(search), pairs,
    )  # fmt: skip
    return pairs[:count]
