"""Robust cost of whitened residuals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import betainc

from multicam.types import FloatArray


@dataclass(frozen=True)
class Student:
    """Negative log-likelihood of a multivariate Student distribution, up to a constant.

    With squared norm s = r' C^-1 r of a residual of dimension d and tail v, the energy is (v + d) / 2 log(1 + s / v). A
    residual keeps the weight (v + d) / (v + s): above one while it is smaller than expected, towards zero for gross
    errors. Lange, Little, Taylor, "Robust statistical modeling using the t distribution" (1989). The Cauchy cost is the
    case v = 1.

    Attributes:
        tail: degrees of freedom v; small values expect many gross errors.
        dimension: d.
    """

    tail: float
    dimension: int

    def energy(self, squared: FloatArray) -> FloatArray:
        """Energy of squared norms; 0 at 0."""
        return (self.tail + self.dimension) / 2 * np.log1p(squared / self.tail)

    def weight(self, squared: FloatArray) -> FloatArray:
        """2 d energy / d squared."""
        return (self.tail + self.dimension) / (self.tail + squared)

    def information(self, squared: FloatArray) -> FloatArray:
        """Share of its stated information that a residual brings, from its squared norm.

        Weights are capped at 1 (small residuals are no proof of precision) and scaled so that over residuals of this
        very distribution they come to its Fisher information, (v + d) / (v + d + 2).
        """
        return self._per_capped_weight * np.minimum(1, self.weight(squared))

    @cached_property
    def _per_capped_weight(self) -> float:
        # The weight is B / E[B] with B ~ Beta(v/2, d/2), so E[min(1, weight)] = P(B' < E[B]) + P(B > E[B]), where B'
        # is B weighted by itself.
        a, b = self.tail / 2, self.dimension / 2
        mean = a / (a + b)
        capped = float(betainc(a + 1, b, mean)) + 1 - float(betainc(a, b, mean))
        return (self.tail + self.dimension) / (self.tail + self.dimension + 2) / capped


PLAIN = Student(1e9, 6)
"""A tail so long that the energy is half the squared norm: for factors whose own terms are bounded already."""
