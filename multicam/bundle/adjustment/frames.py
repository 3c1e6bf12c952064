"""A camera's frame as a picture to adjust on."""

from __future__ import annotations

import cv2
import numpy as np

from multicam.bundle.adjustment.scene import Picture
from multicam.bundle.depth_image import DepthImage
from multicam.types import Frame


def ideal_picture(frame: Frame) -> Picture:
    """Colour and depth as a lens without distortion and with the same camera matrix would have taken them.

    Depths are those of the nearest pixel, for a mean across an edge lies in the air; beyond the border it is unknown.
    """
    camera, image, depth = frame.camera, frame.image, frame.depth
    if camera.distortion:
        size, coefficients = (camera.width, camera.height), np.array(camera.distortion)
        maps = cv2.initUndistortRectifyMap(camera.matrix, coefficients, np.eye(3), camera.matrix, size, cv2.CV_32FC1)
        camera = camera.without_distortion()
        image = cv2.remap(image, *maps, cv2.INTER_LINEAR)
        depth = None if depth is None else cv2.remap(depth, *maps, cv2.INTER_NEAREST)
    assert isinstance(image, np.ndarray)
    measured = None if depth is None else DepthImage(depth.astype(np.float32, copy=False), camera, np.eye(4))
    return Picture(image.astype(np.uint8, copy=False), camera, measured)
