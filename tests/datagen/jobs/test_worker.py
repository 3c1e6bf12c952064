"""How a worker ends when it is told to."""

from __future__ import annotations

import os
import signal

import pytest

from datagen.jobs.worker import end_once


def test_a_second_word_does_not_break_into_what_the_first_puts_in_order() -> None:
    before = signal.signal(signal.SIGTERM, end_once)
    tidied = False
    try:
        with pytest.raises(SystemExit):
            try:
                os.kill(os.getpid(), signal.SIGTERM)
            finally:
                os.kill(os.getpid(), signal.SIGTERM)
                tidied = True
    finally:
        signal.signal(signal.SIGTERM, before)
    assert tidied
