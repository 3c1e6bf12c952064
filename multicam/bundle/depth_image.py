"""A depth picture beside a colour camera: measured by a sensor of its own, or drawn from bodies at known poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from multicam.bundle.occlusion_compiled import nearest_of_blocks
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import render_depths
from multicam.types import FloatArray

PackedDepth = tuple[NDArray[np.float32], NDArray[np.float32], FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class DepthImage:
    """Depth along the optical axis of a camera that is fixed to a colour camera, or is that camera.

    Attributes:
        depth: (height, width) float32, metres; zero, NaN or infinite where nothing is known.
        camera: intrinsics of the depth picture, without distortion.
        depth_from_camera: (4, 4) from the colour camera's frame to the depth camera's.
    """

    depth: NDArray[np.float32]
    camera: Camera
    depth_from_camera: FloatArray

    def __post_init__(self) -> None:
        expected = (self.camera.height, self.camera.width)
        if self.depth.shape != expected or self.depth.dtype != np.float32:
            raise ValueError(f"depth is {self.depth.dtype} {self.depth.shape}, its camera says float32 {expected}")
        if self.camera.distortion:
            raise ValueError("a depth picture needs an ideal lens; undistort it first")

    @cached_property
    def blocks(self) -> NDArray[np.float32]:
        """The nearest depth in each square of `occlusion_compiled.BLOCK` pixels."""
        return nearest_of_blocks(self.depth)

    @cached_property
    def packed(self) -> PackedDepth:
        """What compiled functions look at, of one type whoever made the picture: depth, blocks, matrix, pose."""
        depth, blocks = (np.require(each, np.float32, ["C", "W"]) for each in (self.depth, self.blocks))
        matrix, pose = (
            np.require(each, np.float64, ["C", "W"]) for each in (self.camera.matrix, self.depth_from_camera)
        )
        return depth, blocks, matrix, pose


def draw_bodies(bodies: Sequence[tuple[Mesh, FloatArray]], camera: Camera) -> DepthImage:
    """What the colour camera, or a scaled copy of it, would measure of meshes at poses camera_from_object (4, 4)."""
    depth = render_depths(bodies, camera)
    return DepthImage(np.where(depth > 0, depth, np.float32(np.inf)), camera, np.eye(4))
