"""Parameters of the depth factor."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DepthConfig:
    """Search for measured points (defaults of M3T). Lists advance with each search; their last value stays."""

    points: int = 200
    """Most surface points of one object in one picture."""
    radii: tuple[float, ...] = (0.05, 0.02, 0.01)
    """Metres within which the nearest measured point is taken."""
    deviations: tuple[float, ...] = (0.05, 0.03, 0.02)
    """Standard deviation of a measured depth, metres at a depth of one metre; it grows in proportion."""
    spacings: tuple[float, ...] = (0.01,)
    """About how far apart, metres, the pixels lie that are looked at."""

    def radius(self, search: int) -> float:
        """Of the search with that number, from 0."""
        return self.radii[min(search, len(self.radii) - 1)]

    def spacing(self, search: int) -> float:
        """Of the search with that number, from 0."""
        return self.spacings[min(search, len(self.spacings) - 1)]

    def deviation(self, search: int) -> float:
        """Of the search with that number, from 0."""
        return self.deviations[min(search, len(self.deviations) - 1)]
