"""Which estimate answers for which true object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from multicam.types import FloatArray

Estimated = TypeVar("Estimated")
True_ = TypeVar("True_")


def assign_greedily(
    estimates: Sequence[Estimated], truths: Sequence[True_], error: Callable[[Estimated, True_], float]
) -> list[tuple[int, float] | None]:
    """For each truth the index of its estimate and their error, or None; BOP's rule.

    Estimates come in order of falling score; each takes the truth with the least error among those still free. Only
    as many estimates as there are truths may answer, so that guessing twice does not pay.
    """
    answers: list[tuple[int, float] | None] = [None] * len(truths)
    for index, estimate in enumerate(estimates[: len(truths)]):
        free = [i for i, answer in enumerate(answers) if answer is None]
        errors = {i: error(estimate, truths[i]) for i in free}
        best = min(errors, key=errors.__getitem__)
        answers[best] = index, errors[best]
    return answers


def found_below(errors: FloatArray, threshold: float) -> NDArray[np.bool_]:
    """Which truths count as found at a threshold of correctness; BOP's rule for recall.

    By falling score, each estimate takes the truth with the least error among those still free, if that error is below
    the threshold; otherwise it takes none, and the truth is left to the estimates after it.

    Args:
        errors: (estimates, truths), rows in order of falling score and no more of them than truths.

    Returns:
        (truths,) bool.
    """
    found = np.zeros(errors.shape[1], dtype=np.bool_)
    for row in errors:
        left = np.where(found, np.inf, row)
        best = int(np.argmin(left))
        found[best] |= bool(left[best] < threshold)
    return found


def found_share(errors: FloatArray, thresholds: Sequence[float]) -> FloatArray:
    """(truths,) share of the thresholds at which each is found; its mean over truths is BOP's average recall."""
    return np.mean([found_below(errors, threshold) for threshold in thresholds], axis=0)
