"""Parameters of the fits."""

from __future__ import annotations

from dataclasses import dataclass, field

from multicam.bundle.tracking import TrackingConfig
from multicam.errors import ConfigError


@dataclass(frozen=True)
class FitConfig:
    """Detections brought to measured depth (docs/bundle.md)."""

    enabled: bool = False
    """Whether to do it in cameras that measure depth: up to a tenth of a second of one core for each detection."""
    tracking: TrackingConfig = field(default_factory=lambda: TrackingConfig(searches=7))
    """Search and steps from each start."""
    attitudes: int = 300
    """Attitudes, evenly over all, that are tried at the box of a detection; 0 leaves them out."""
    followed: int = 8
    """From how many of these and of the half turns of an estimate is searched: those that the depth bears out best."""
    confirms: float = 0.008
    """Depth that differs from that of a pose by less confirms it, and by less than half of it confirms it tightly,
    metres."""
    contradicts: float = 0.015
    """Depth that differs by more contradicts it: wholly if it lies behind, by half if something may hide the object."""
    least: float = 0.65
    """What each of three shares must reach for a pose to be taken: of pixels that confirm it less those that contradict
    it, of pixels that confirm it tightly, and of lines on which colours show the contour."""
    enough: float = 0.88
    """The same at which no other start is tried."""
    pixels: int = 20
    """Least pixels of measured depth that an object must cover at half size."""
    inflation: float = 4.0
    """How much larger variances are than lines and points say, which are not independent."""
    least_std: tuple[float, float] = (0.02, 0.003)
    """Least deviations of a fitted pose, per axis, radians and metres."""

    def __post_init__(self) -> None:
        if not 0 < self.confirms <= self.contradicts:
            raise ConfigError(f"fit.confirms must lie above 0 and not above fit.contradicts; it is {self.confirms:g}.")
        if not 0 < self.least <= self.enough:
            raise ConfigError(f"fit.least must lie above 0 and not above fit.enough; it is {self.least:g}.")
        if self.attitudes < 0 or self.followed < 1:
            raise ConfigError("fit.attitudes must not be negative, and fit.followed starts at 1.")
