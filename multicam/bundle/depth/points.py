"""Measured points near the surface of one object in one depth picture, at one pose."""

from __future__ import annotations

import numpy as np

from multicam.bundle.depth.compiled import PAIR, search_points
from multicam.bundle.depth.config import DepthConfig
from multicam.bundle.depth_image import DepthImage
from multicam.bundle.groups import RecordArray
from multicam.bundle.occlusion import Occluders
from multicam.bundle.viewpoints.model import ViewpointModel
from multicam.geometry import se3
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
    depth_from_object = image.depth_from_camera @ camera_from_object
    view = model.closest_view(depth_from_object)
    if model.surface_area[view] == 0:
        return np.empty(0, PAIR)
    n = config.points
    point = model.surface_point[view, :n]
    seen = occluders.visible(point, model.surface_offset[view, :n], model.offset_step, camera_from_object)
    pairs = np.empty(len(point), PAIR)
    count = search_points(
        image.depth, image.camera.matrix, depth_from_object, se3.inverse(image.depth_from_camera),
        point, model.surface_normal[view, :n], seen,
        config.radius(search), config.spacing(search), config.deviation(search), pairs,
    )  # fmt: skip
    return pairs[:count]
