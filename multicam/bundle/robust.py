"""Robust cost of whitened residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
