"""How much more likely two poses are as one object seen twice than as two unrelated ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaln

from multicam.types import FloatArray


@dataclass(frozen=True)
class LikelihoodConfig:
    """The two explanations of a pair of estimates: one object, or clutter."""

    tail: float = 2.0
    """Degrees of freedom of the Student distribution of estimates; small values expect many gross errors."""
    clutter_volume: float = 0.1
    """Volume, cubic metres, over which estimates that belong to nothing spread; their attitudes are arbitrary."""

    gate: float = 20.0
    """Mahalanobis distance beyond which two estimates are never one object: a heavy tail alone would allow it."""

    def __post_init__(self) -> None:
        if min(self.tail, self.clutter_volume, self.gate) <= 0:
            raise ValueError("tail, clutter_volume and gate must be positive")

    @cached_property
    def log_clutter(self) -> float:
        """Log density of an unrelated pose: all attitudes (their volume is 8 pi^2) times the clutter volume."""
        return -float(np.log(8 * np.pi**2 * self.clutter_volume))

    def log_ratio(self, squared: FloatArray, log_determinant: FloatArray) -> FloatArray:
        """Log of the ratio of the two densities of a pose difference; minus infinity beyond the gate.

        Args:
            squared: r' C^-1 r of the six-dimensional residual r.
            log_determinant: of its covariance C.
        """
        student = self._log_peak - log_determinant / 2 - (self.tail + 6) / 2 * np.log1p(squared / self.tail)
        return np.where(squared <= self.gate**2, student - self.log_clutter, -np.inf)

    @cached_property
    def _log_peak(self) -> float:
        """Log density of the Student distribution of unit scale at zero."""
        return float(gammaln((self.tail + 6) / 2) - gammaln(self.tail / 2) - 3 * np.log(self.tail * np.pi))

    def weight(self, squared: FloatArray) -> FloatArray:
        """Weight of a residual in a least-squares step that raises the Student likelihood."""
        return (self.tail + 6) / (self.tail + squared)
