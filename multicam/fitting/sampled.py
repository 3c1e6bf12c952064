"""What a body would show at poses, by the points of its nearest view: less exact than a drawing, and much faster."""

from __future__ import annotations

import numpy as np

from multicam.bundle.depth_image import DepthImage
from multicam.bundle.viewpoints.model import ViewpointModel
from multicam.fitting import compiled
from multicam.types import FloatArray


def outline_sides(model: ViewpointModel, camera_matrix: FloatArray, camera_from_object: FloatArray) -> FloatArray:
    """(n, 2) width and height of the outline at poses (n, 4, 4), pixels."""
    sides = np.empty((len(camera_from_object), 2))
    compiled.outline_sides(camera_matrix, camera_from_object, model.direction, model.contour_point, sides)
    return sides


def surface_errors(model: ViewpointModel, depth: DepthImage, camera_from_object: FloatArray) -> FloatArray:
    """(n,) by how much measured depth lies behind points of the surface at a pose (4, 4), metres.

    Left out are points outside the picture and those whose depth is not known.
    """
    image, _, matrix, depth_from_camera = depth.packed
    errors = np.empty(model.surface_point.shape[1])
    pose = depth_from_camera @ camera_from_object
    return errors[: compiled.surface_errors(image, matrix, pose, model.direction, model.surface_point, errors)]
