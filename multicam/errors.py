"""Errors a user can act on: what was wrong, what was there, what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class MulticamError(Exception):
    """A mistake in the input; the command line prints its one sentence and exits with code 2."""


class ConfigError(MulticamError):
    """A configuration file or flag that does not fit its schema."""


class DataError(MulticamError):
    """A data file that is missing, malformed or inconsistent."""


class ModelError(MulticamError):
    """A network file that is not ours or does not fit the data."""


class MissingDependencyError(MulticamError):
    """An optional package that a command needs is not installed."""


def describe(error: Exception) -> str:
    """What a reader's exception says of the data, as the end of a sentence."""
    return f'"{error.args[0]}" is missing' if isinstance(error, KeyError) else str(error)


def did_you_mean(name: str, valid: Iterable[str]) -> str:
    """Returns ' (did you mean "x"?)' for the closest valid name, or an empty string."""
    close = difflib.get_close_matches(name, list(valid), n=1, cutoff=0.5)
    return f' (did you mean "{close[0]}"?)' if close else ""
