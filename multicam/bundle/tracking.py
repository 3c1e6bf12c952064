"""One object followed through pictures: search, a few damped steps, search again (as ICG and M3T do)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from multicam.bundle.depth.config import DepthConfig
from multicam.bundle.depth.factor import DepthFactor
from multicam.bundle.depth.points import find_points
from multicam.bundle.depth_image import DepthImage
from multicam.bundle.factor import EdgeFactor
from multicam.bundle.ideal import require_ideal
from multicam.bundle.occlusion import Occluders
from multicam.bundle.region.colors import ColorModel, colors_at
from multicam.bundle.region.config import RegionConfig
from multicam.bundle.region.factor import RegionFactor
from multicam.bundle.region.lines import find_lines
from multicam.bundle.viewpoints.model import ViewpointModel
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.matching.linear import solve
from multicam.types import FloatArray, ImageArray

FIRM_MEAN, FIRM_VARIANCE = 2.0, 4.0
"""Segments, and their square: a line shows the contour if its posterior lies so near and is so narrow. Where colours
are the same on both sides its variance is 11.9, on a perfect line 0.5."""

_ONLY = np.zeros(1, dtype=np.int64)


@dataclass(frozen=True)
class TrackingConfig:
    """How an object is followed (defaults of M3T)."""

    region: RegionConfig | None = field(default_factory=RegionConfig)
    """Lines on the colour picture; null leaves them out."""
    depth: DepthConfig | None = field(default_factory=DepthConfig)
    """Points of the depth picture, where there is one; null leaves them out."""
    searches: int = 5
    """Searches for lines and points."""
    updates: int = 2
    """Steps after each search."""
    rotation_damping: float = 1000.0
    """Added to the Hessian's diagonal: information, per squared radian, that the object stays where it is."""
    translation_damping: float = 30000.0
    """The same per squared metre."""


@dataclass(frozen=True, eq=False)
class Sight:
    """What one camera sees of the world at a time.

    Attributes:
        image: (height, width, 3) RGB.
        camera: its intrinsics, without distortion.
        camera_from_world: (4, 4).
        depth: the picture of the depth camera beside it, or None.
        occluders: depth pictures of what may hide the object; the measured one is not among them by itself.
    """

    image: ImageArray
    camera: Camera
    camera_from_world: FloatArray
    depth: DepthImage | None = None
    occluders: Occluders = field(default_factory=Occluders)

    def __post_init__(self) -> None:
        require_ideal(self.image, self.camera)


@dataclass(frozen=True, eq=False)
class Tracked:
    """Where an object was found.

    Attributes:
        world_from_object: (4, 4).
        energy: of the last search's lines and points, before its last step.
        hessian: (6, 6) of it in the object's right tangent, without damping: what the pictures say of the pose.
        lines, points: how many the last search found, over all sights.
        firm: lines of them on which colours show the contour, and about where it was; an object that is lost has few.
    """

    world_from_object: FloatArray
    energy: float
    hessian: FloatArray
    lines: int
    points: int
    firm: int


def first_colors(
    model: ViewpointModel, sight: Sight, world_from_object: FloatArray, config: RegionConfig
) -> ColorModel:
    """Colours in one sight of an object whose pose (4, 4) is about right."""
    return updated_colors(ColorModel.uniform(), model, sight, world_from_object, replace(config, learning_rate=1.0))


def updated_colors(
    colors: ColorModel, model: ViewpointModel, sight: Sight, world_from_object: FloatArray, config: RegionConfig
) -> ColorModel:
    """Colours after one more sight of an object at a pose (4, 4)."""
    pose = sight.camera_from_world @ world_from_object
    counts = colors_at(model, sight.image, sight.camera.matrix, pose, sight.occluders, config)
    return colors.blended(counts, config.learning_rate)


def shows(
    model: ViewpointModel, sight: Sight, colors: ColorModel, world_from_object: FloatArray, config: TrackingConfig
) -> tuple[int, int]:
    """How many lines a last search finds at a pose (4, 4), and on how many of them colours show the contour."""
    found = _search(model, sight, colors, world_from_object, config.searches - 1, config)
    return found.lines, found.firm


def track(
    model: ViewpointModel,
    sights: Sequence[Sight],
    colors: Sequence[ColorModel],
    world_from_object: FloatArray,
    config: TrackingConfig,
) -> Tracked:
    """Follows an object from a pose (4, 4) into sights of one time.

    Without any line or point, the pose stays what it was.

    Args:
        colors: of the object in each sight.
    """
    damping = np.diag([config.rotation_damping] * 3 + [config.translation_damping] * 3)
    pose, energy, hessian, lines, points, firm = world_from_object, 0.0, np.zeros((6, 6)), 0, 0, 0
    for search in range(config.searches):
        found = [_search(model, each, known, pose, search, config) for each, known in zip(sights, colors, strict=True)]
        lines, points = sum(each.lines for each in found), sum(each.points for each in found)
        firm = sum(each.firm for each in found)
        for update in range(config.updates):
            energy, gradient, hessian = 0.0, np.zeros(6), np.zeros((6, 6))
            for each in found:
                for factor in each.factors(update, config):
                    terms = factor.linearize((each.sight.camera_from_world @ pose)[None])
                    energy += float(terms.energy[0])
                    gradient += terms.gradient[0]
                    hessian += terms.hessian[0]
            pose = se3.plus(pose, solve(hessian + damping, -gradient))
    return Tracked(pose, energy, hessian, lines, points, firm)


@dataclass(frozen=True, eq=False)
class _Found:
    """What a search found in one sight; each factor has one edge."""

    sight: Sight
    region: RegionFactor | None
    depth: DepthFactor | None

    @property
    def lines(self) -> int:
        """How many lines."""
        return 0 if self.region is None else len(self.region.lines)

    @property
    def firm(self) -> int:
        """How many lines show the contour about where it was."""
        if self.region is None:
            return 0
        lines = self.region.lines
        return int(np.count_nonzero((np.abs(lines["mean"]) < FIRM_MEAN) & (lines["variance"] < FIRM_VARIANCE)))

    @property
    def points(self) -> int:
        """How many points."""
        return 0 if self.depth is None else len(self.depth.pairs)

    def factors(self, update: int, config: TrackingConfig) -> Iterator[EdgeFactor]:
        """Those that there are, as they are used in the update of that number, from 0, after the search."""
        if self.region is not None and config.region is not None:
            yield self.region.in_update(update, config.region)
        if self.depth is not None:
            yield self.depth


def _search(
    model: ViewpointModel,
    sight: Sight,
    colors: ColorModel,
    world_from_object: FloatArray,
    search: int,
    config: TrackingConfig,
) -> _Found:
    """Lines and points of an object at a pose (4, 4)."""
    pose, matrix = sight.camera_from_world @ world_from_object, sight.camera.matrix
    region = depth = None
    if config.region is not None:
        lines = find_lines(model, sight.image, matrix, pose, colors, sight.occluders, search, config.region)
        region = RegionFactor.of_edges(_ONLY, _ONLY, matrix[None], [lines], config.region)
    if config.depth is not None and sight.depth is not None:
        pairs = find_points(model, sight.depth, pose, sight.occluders, search, config.depth)
        depth = DepthFactor.of_edges(_ONLY, _ONLY, [pairs])
    return _Found(sight, region, depth)
