"""Parameters of the scenery."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SceneryConfig:
    """How points beside the objects are matched, and what they must show before they are believed."""

    features: int = 2000
    """Most points of a picture, the strongest ones."""
    contrast: float = 0.01
    """Least contrast of a point, SIFT's measure; below its usual 0.04, for more points."""
    ratio: float = 0.85
    """A match is the best in both directions, its distance below this share of the next best one's (Lowe)."""
    std: float = 1.0
    """Deviation of a match from its epipolar line, pixels."""
    samples: int = 1000
    """Draws of five matches, each a guess of the motion between two cameras."""
    guesses: int = 8
    """Guesses that are refined, the best ones that differ."""
    least_matches: int = 50
    """Matches that must lie on their epipolar lines, within three deviations; as many as ORB-SLAM asks of its start."""
    margin: float = 10.0
    """By how much, in log likelihood, the best motion must beat others: points in one plane have two, and repeating
    patterns more. Others nearby make it less certain, others further away leave it unknown."""
    rotation_std: float = 0.01
    """Deviation of a motion's turn that no number of matches takes away, radians: lenses, clocks, wrong matches."""
    direction_std: float = 0.02
    """The same of its direction, radians."""
