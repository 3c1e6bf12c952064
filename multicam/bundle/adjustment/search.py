"""Lines and points of every edge at the poses of a state, and the colours that they are found by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from multicam.bundle.adjustment.config import AdjustmentConfig
from multicam.bundle.adjustment.scene import Scene
from multicam.bundle.cores import over_cores
from multicam.bundle.depth.factor import DepthFactor
from multicam.bundle.depth.points import PairArray, find_points
from multicam.bundle.depth_image import draw_bodies
from multicam.bundle.factor import EdgeFactor, Linearization
from multicam.bundle.occlusion import Occluders
from multicam.bundle.problem import State
from multicam.bundle.region.colors import ColorModel, colors_at
from multicam.bundle.region.factor import RegionFactor
from multicam.bundle.region.lines import LineArray, find_lines
from multicam.geometry import se3
from multicam.matching.arrays import IntArray
from multicam.types import FloatArray

DRAWN = 0.5
"""Share of a picture's width at which bodies are drawn to see which hides which; patches are wider than its pixels."""


def edge_poses(scene: Scene, state: State) -> FloatArray:
    """(e, 4, 4) camera_from_object of the edges."""
    return state.camera_from_object(scene.camera, scene.object)


def find_occluders(scene: Scene, state: State, config: AdjustmentConfig) -> list[Occluders]:
    """(c,) what may hide objects in each picture."""
    camera_from_world = se3.inverse(state.world_from_camera)

    def of_camera(camera: int) -> Occluders:
        picture, pose = scene.pictures[camera], camera_from_world[camera]
        images = [picture.depth] if config.measured_occlusion and picture.depth is not None else []
        if config.modelled_occlusion and len(scene.bodies) > 1:
            placed = [
                (body.mesh, pose @ each) for body, each in zip(scene.bodies, state.world_from_object, strict=True)
            ]
            images.append(draw_bodies(placed, picture.camera.scaled(DRAWN)))
        return Occluders(tuple(images))

    return over_cores(of_camera, range(len(scene.pictures)))


def learn_colors(
    scene: Scene, poses: FloatArray, occluders: Sequence[Occluders], config: AdjustmentConfig
) -> list[ColorModel]:
    """(e,) colours of each object in each picture that sees it, at poses camera_from_object (e, 4, 4)."""
    region = config.region
    if region is None:
        return []

    def of_edge(edge: int) -> ColorModel:
        camera, pose = scene.camera[edge], poses[edge]
        picture, body = scene.pictures[camera], scene.bodies[scene.object[edge]]
        counts = colors_at(body.model, picture.image, picture.camera.matrix, pose, occluders[camera], region)
        return ColorModel.uniform().blended(counts, 1.0)

    return over_cores(of_edge, range(len(scene.camera)))


@dataclass(frozen=True, eq=False)
class Found:
    """What one search found: factors whose edges are those of the scene, or some of them.

    Attributes:
        region, depth: factors, or None where they are left out.
        edge_of_point: (k,) which edges of the scene those of `depth` are: of the cameras that measure depth.
        edges: e.
    """

    region: RegionFactor | None
    depth: DepthFactor | None
    edge_of_point: IntArray
    edges: int

    @classmethod
    def nothing(cls, edges: int) -> Found:
        """Neither lines nor points."""
        return cls(None, None, np.empty(0, np.int64), edges)

    def linearize(self, pose: FloatArray) -> Linearization:
        """What all lines and points of each edge (e,) say at poses (e, 4, 4)."""
        energy, gradient, hessian = np.zeros(self.edges), np.zeros((self.edges, 6)), np.zeros((self.edges, 6, 6))
        every = np.arange(self.edges)
        parts: list[tuple[EdgeFactor | None, IntArray]] = [(self.region, every), (self.depth, self.edge_of_point)]
        for factor, edge in parts:
            if factor is not None:
                local = factor.linearize(pose[edge])
                energy[edge] += local.energy
                gradient[edge] += local.gradient
                hessian[edge] += local.hessian
        return Linearization(energy, gradient, hessian)

    def in_update(self, update: int, config: AdjustmentConfig) -> Found:
        """The same lines and points as they are used in the update of that number, from 0, after their search."""
        if self.region is None or config.region is None:
            return self
        return replace(self, region=self.region.in_update(update, config.region))

    @property
    def lines(self) -> IntArray:
        """(e,) how many lines each edge has."""
        return np.zeros(self.edges, np.int64) if self.region is None else np.diff(self.region.start)

    @property
    def points(self) -> IntArray:
        """(e,) how many points."""
        count = np.zeros(self.edges, np.int64)
        if self.depth is not None:
            count[self.edge_of_point] = np.diff(self.depth.start)
        return count


def search_pictures(
    scene: Scene,
    state: State,
    occluders: Sequence[Occluders],
    colors: Sequence[ColorModel],
    search: int,
    config: AdjustmentConfig,
) -> Found:
    """Lines and points of all edges.

    Args:
        occluders: (c,).
        colors: (e,).
        search: number of the search, from 0, by which scales, radii and deviations advance.
    """
    pose = edge_poses(scene, state)

    def search_edge(edge: int) -> tuple[LineArray | None, PairArray | None]:
        camera, model, at = scene.camera[edge], scene.bodies[scene.object[edge]].model, pose[edge]
        picture, hidden = scene.pictures[camera], occluders[camera]
        lines = pairs = None
        if config.region is not None:
            lines = find_lines(
                model, picture.image, picture.camera.matrix, at, colors[edge], hidden, search, config.region, finer=True
            )
        if config.depth is not None and picture.depth is not None:
            pairs = find_points(model, picture.depth, at, hidden, search, config.depth)
        return lines, pairs

    found = over_cores(search_edge, range(len(pose)))
    region = depth = None
    if config.region is not None:
        matrices = np.array([scene.pictures[camera].camera.matrix for camera in scene.camera]).reshape(-1, 3, 3)
        lines = [each for each, _ in found if each is not None]
        region = RegionFactor.of_edges(scene.camera, scene.object, matrices, lines, config.region)
    measured = np.array([n for n, (_, pairs) in enumerate(found) if pairs is not None], dtype=np.int64)
    if len(measured):
        pairs = [each for _, each in found if each is not None]
        depth = DepthFactor.of_edges(scene.camera[measured], scene.object[measured], pairs)
    return Found(region, depth, measured, len(pose))
