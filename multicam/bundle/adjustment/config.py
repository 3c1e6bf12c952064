"""Parameters of the adjustment."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from multicam.bundle.depth.config import DepthConfig
from multicam.bundle.region.config import RegionConfig
from multicam.bundle.scenery.config import SceneryConfig


@dataclass(frozen=True)
class AdjustmentConfig:
    """How cameras and objects are adjusted; docs/bundle.md has the equations and what each value is worth."""

    region: RegionConfig | None = field(
        default_factory=lambda: RegionConfig(scales=(7, 4, 2, 1), deviations=(20.0, 11.0, 7.0, 5.0))
    )
    """Lines on the colour pictures; null leaves them out."""
    depth: DepthConfig | None = field(
        default_factory=lambda: DepthConfig(
            radii=(0.05, 0.03, 0.02, 0.01),
            deviations=(0.05, 0.02, 0.01, 0.007),
            spacings=(0.01, 0.006, 0.004, 0.0025),
        )
    )
    """Points of the depth pictures, where there are any; null leaves them out."""
    scenery: SceneryConfig | None = None
    """What two pictures share beside the objects; it shows turns and directions of cameras, but must stand still."""
    searches: int = 6
    """Searches for lines and points."""
    updates: int = 2
    """Steps after each search."""
    relearn: int = 4
    """Searches in each picture by itself after which colours are learnt anew where the object is by then; 0: never."""
    rotation_damping: float = 100.0
    """Information, per squared radian and edge, that a step leaves the object where the camera sees it."""
    translation_damping: float = 1000.0
    """The same per squared metre."""
    tail: float = 1.0
    """Degrees of freedom of the Student distribution of edges; small values expect many objects that were moved, or are
    others than they seem."""
    modelled_occlusion: bool = True
    """Whether lines and points are left out that another body, where it is thought to stand, would hide."""
    measured_occlusion: bool = True
    """Whether those are left out that something in the depth picture hides."""
    joint: bool = True
    """One system for all; otherwise objects and cameras take turns, as in the paper."""
    gate: float = 22.46
    """Greatest squared Mahalanobis distance from its prior that a camera or object may move: the 99.9 % quantile with
    six degrees of freedom."""

    def __post_init__(self) -> None:
        if not self.last_searches:
            raise ValueError(
                f"searches is {self.searches}, must be at least 1 and no fewer than relearn, {self.relearn}"
            )

    @property
    def last_searches(self) -> range:
        """Numbers of the searches that begin where others have ended, as those after colours are learnt anew."""
        return range(max(self.relearn - 1, 0), self.searches)

    def judging(self) -> AdjustmentConfig:
        """Searches as wide as the first and as precise as the last, to compare energies of two states.

        A narrow search finds less, and so a lower energy, where a pose is further off.
        """
        region, depth = self.region, self.depth
        if region is not None:
            region = replace(region, scales=region.scales[:1], deviations=region.deviations[-1:])
        if depth is not None:
            depth = replace(depth, radii=depth.radii[:1], deviations=depth.deviations[-1:], spacings=depth.spacings[:1])
        return replace(self, region=region, depth=depth)
