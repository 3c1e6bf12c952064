"""Helpers to break files and to look at the one sentence that a user then reads."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from multicam.errors import MulticamError


def sentence(call: Callable[[], object]) -> str:
    """The message of the MulticamError that the call raises: one line, ended as a sentence."""
    with pytest.raises(MulticamError) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text
    assert text.endswith((".", "?"))
    return text


def edit_json(path: Path, edit: Callable[[Any], object]) -> None:
    """Changes a JSON file in place; NaN is written as Python and many exporters write it."""
    value = json.loads(path.read_text())
    edit(value)
    path.write_text(json.dumps(value))
