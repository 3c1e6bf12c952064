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

    min_probability: float = 0.98
    """Least probability that its pose is right, against chance and against the second best pose."""
    max_rotation_std: float = 0.15
    """Largest root mean square error of its attitude that its covariance may state, radians."""
    max_position_std: float = 0.15
    """Largest root mean square error of its position that its covariance may state, metres."""

    def __post_init__(self) -> None:
        if not 0.5 <= self.min_probability < 1:
            raise ValueError(f"min_probability must lie in [0.5, 1); it is {self.min_probability}")
        if min(self.max_rotation_std, self.max_position_std) <= 0:
            raise ValueError("max_rotation_std and max_position_std must be positive")

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
