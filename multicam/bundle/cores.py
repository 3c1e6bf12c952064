"""Work of compiled functions, which let go of Python's lock, spread over the processor's cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def over_cores(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """As `[function(item) for item in items]`; each core takes every n-th item, the caller's own the first."""
    cores = min(_count(), len(items))
    if cores < 2:
        return [function(item) for item in items]

    def share(core: int) -> list[Result]:
        return [function(item) for item in items[core::cores]]

    others = _threads().map(share, range(1, cores))
    done = [share(0), *others]
    return [done[n % cores][n // cores] for n in range(len(items))]


@cache
def _count() -> int:
    return os.cpu_count() or 1


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_name_prefix="bundle")
