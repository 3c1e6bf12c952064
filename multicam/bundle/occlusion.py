"""Which points of an object something nearer to the camera hides, by depth pictures measured or drawn."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multicam.bundle.depth_image import DepthImage, PackedDepth
from multicam.bundle.occlusion_compiled import find_visible
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
        return find_visible(*self.packed, point, offset, offset_step, camera_from_object)

    @cached_property
    def packed(self) -> tuple[tuple[PackedDepth, ...], float, float]:
        """What compiled functions look at: pictures (without any, an empty one), radius, threshold."""
        images = tuple(image.packed for image in self.images) or (_NOTHING,)
        return images, self.config.radius, self.config.threshold


_NOTHING: PackedDepth = (np.empty((0, 0), np.float32), np.empty((0, 0), np.float32), np.eye(3), np.eye(4))
