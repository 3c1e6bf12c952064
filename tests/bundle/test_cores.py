from __future__ import annotations

import os
import threading

import pytest

from multicam.bundle.cores import over_cores


@pytest.mark.parametrize("count", [0, 1, 2, 3, 7, 20])
def test_results_come_in_the_order_of_the_items(count: int) -> None:
    assert over_cores(lambda n: n * n, range(count)) == [n * n for n in range(count)]


def test_an_error_reaches_the_caller() -> None:
    with pytest.raises(ZeroDivisionError):
        over_cores(lambda n: 1 // n, [3, 2, 1, 0])


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core does all by itself")
def test_two_cores_work_at_the_same_time() -> None:
    """Each waits for the other; one alone would break the barrier."""
    both = threading.Barrier(2, timeout=10)

    def meet(item: int) -> int:
        return item if item > 1 else both.wait() * 0 + item

    assert over_cores(meet, [0, 1, 2, 3]) == [0, 1, 2, 3]
