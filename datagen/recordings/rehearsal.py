"""Draws recordings until one keeps its promises, before anything is rendered."""

from __future__ import annotations

import logging

from datagen.recordings.config import SequenceConfig
from datagen.recordings.foresight import foresee
from datagen.recordings.sight import verify_sight
from datagen.recordings.stage import Stage, draw_stage
from datagen.recordings.statics import BOARD_CORNERS, SPARE_CORNERS, Unsuitable
from datagen.scenes.stock import Stock

_ATTEMPTS = 40
_log = logging.getLogger(__name__)


def sample_stage(config: SequenceConfig, stock: Stock) -> Stage:
    """The recording of a configuration; same arguments, same recording.

    Raises:
        DataError: the models do not suffice, or no draw of this seed keeps what the configuration promises; the
            sentence is that of the last one.
    """
    for attempt in range(_ATTEMPTS):
        try:
            stage = draw_stage(config, stock, attempt)
            verify_sight(foresee(stage, stock), stage, BOARD_CORNERS + SPARE_CORNERS)
            return stage
        except Unsuitable as problem:
            _log.debug("attempt %d: %s", attempt, problem)
            if attempt == _ATTEMPTS - 1:
                raise
    raise AssertionError("the last attempt returns or raises")
