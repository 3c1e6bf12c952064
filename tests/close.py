"""Comparison of arrays by an absolute tolerance; NumPy's allclose adds one part in 100 000 of its own."""

from __future__ import annotations

from typing import Any

import numpy as np


def assert_close(found: Any, expected: Any, atol: float = 1e-9, rtol: float = 0.0) -> None:
    """Fails, with the greatest difference, unless shapes agree and |found - expected| <= atol + rtol |expected|."""
    np.testing.assert_allclose(found, expected, rtol=rtol, atol=atol)
