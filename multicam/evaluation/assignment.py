"""Which estimate answers for which true object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

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
