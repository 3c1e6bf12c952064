"""Parameters of the region factor."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RegionConfig:
    """Correspondence lines and colours (defaults of M3T). Lists advance with each search; their last value stays."""

    lines: int = 200
    """Most correspondence lines of one object in one picture."""
    scales: tuple[int, ...] = (6, 4, 2, 1)
    """Pixels in one segment of a line, along the axis it follows most."""
    deviations: tuple[float, ...] = (15.0, 5.0, 3.5, 1.5)
    """Standard deviation of the contour, pixels."""
    clear: float = 3.0
    """Segments for which there must be only object on one side of the contour and none of it on the other."""
    gain: float = 1.3
    """How far a local step follows the slope of the log-posterior."""
    global_updates: int = 1
    """Updates after a search that use mean and variance of the posterior; later ones use its slope."""
    nearest: float = 0.5
    """Distance from the contour, pixels, from which colours are counted."""
    farthest: float = 20.0
    """Length, pixels, over which they are counted."""
    learning_rate: float = 0.2
    """Share of new colours when a colour model is updated."""

    def scale(self, search: int) -> int:
        """Of the search with that number, from 0."""
        return self.scales[min(search, len(self.scales) - 1)]

    def deviation(self, search: int) -> float:
        """Of the search with that number, from 0."""
        return self.deviations[min(search, len(self.deviations) - 1)]
