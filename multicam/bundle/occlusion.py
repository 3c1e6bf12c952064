"""Which points of an object something nearer to the camera hides, by depth pictures measured or drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.bundle.depth_image import DepthImage
from multicam.bundle.occlusion_compiled import mark_hidden
from multicam.bundle.viewpoints.model import Float32Array
from multicam.matching.arrays import BoolArray
from multicam.types import FloatArray


@dataclass(frozen=True)
class OcclusionConfig:
    """When a point counts as hidden (defaults of Stoiber et al., "A multi-body tracking framework", ICRA 2023)."""

    radius: float = 0.01
    """Half the side of the patch around a point that is looked at, metres."""
    threshold: float = 0.03
    """How far before the object's own surface within that radius something must stand, metres."""


@dataclass(frozen=True, eq=False)
class Occluders:
    """Depth pictures of all that may stand before an object; without any, nothing is hidden.

    Attributes:
        images: measured by a depth camera, drawn from bodies (see `draw_bodies`), or both.
    """

    images: tuple[DepthImage, ...] = ()
    config: OcclusionConfig = OcclusionConfig()

    def visible(
        self, point: Float32Array, offset: Float32Array, offset_step: float, camera_from_object: FloatArray
    ) -> BoolArray:
        """(n,) whether nothing hides points (n, 3) of the object frame, in any picture.

        A point beside a picture, or where it knows no depth, is not hidden by it.

        Args:
            offset: (n, k) depth offsets of the points, as ViewpointModel has them.
        """
        seen = np.ones(len(point), dtype=np.bool_)
        within = min(int(self.config.radius / offset_step + 0.5), offset.shape[-1] - 1)
        for image in self.images:
            mark_hidden(
                image.depth, image.blocks, image.camera.matrix, image.depth_from_camera @ camera_from_object,
                point, offset[:, within], self.config.radius, self.config.threshold, seen,
            )  # fmt: skip
        return seen
