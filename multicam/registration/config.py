"""Everything that can be set about a registration."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from multicam.bundle.levenberg import LevenbergConfig
from multicam.matching.consensus import ConsensusConfig
from multicam.matching.noise import NoiseConfig


@dataclass(frozen=True)
class PlacementConfig:
    """When a camera is placed."""

    min_probability: float = 0.95
    """Least probability that its pose is right, against chance and against the second best pose."""
    max_rotation_error_deg: float = 10.0
    """A camera whose attitude is off by more is of no use, degrees."""
    max_position_error: float = 0.1
    """A camera whose position is off by more is of no use, metres."""
    min_useful: float = 0.5
    """Least probability, by its covariance, that neither is."""

    def __post_init__(self) -> None:
        if not 0.5 <= self.min_probability < 1:
            raise ValueError(f"min_probability must lie in [0.5, 1); it is {self.min_probability}")
        if not 0 <= self.min_useful < 1:
            raise ValueError(f"min_useful must lie in [0, 1); it is {self.min_useful}")
        if min(self.max_rotation_error_deg, self.max_position_error) <= 0:
            raise ValueError("max_rotation_error_deg and max_position_error must be positive")

    @property
    def min_log_odds(self) -> float:
        """`min_probability` as log odds."""
        return float(np.log(self.min_probability / (1 - self.min_probability)))


@dataclass(frozen=True)
class RegistrationConfig:
    """One set of values for all data; docs/registration.md explains each with its equation."""

    noise: NoiseConfig = field(default_factory=NoiseConfig)
    """Noise of estimates that state none."""
    consensus: ConsensusConfig = field(default_factory=ConsensusConfig)
    """When objects agree on a relative camera pose."""
    placement: PlacementConfig = field(default_factory=PlacementConfig)
    """When a camera is placed."""
    solver: LevenbergConfig = field(default_factory=LevenbergConfig)
    """The joint refinement."""
