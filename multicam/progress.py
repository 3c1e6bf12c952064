"""Progress of long work, as a protocol; libraries report, the command line draws."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

Item = TypeVar("Item")


class Progress(Protocol):
    """Anything that can show how far some counted work has come."""

    def track(self, items: Iterable[Item], description: str, total: int | None = None) -> Iterator[Item]:
        """Yields the items unchanged and shows how many are done, how fast, and the time left."""
        ...


class SilentProgress:
    """Shows nothing; the default of libraries."""

    def track(self, items: Iterable[Item], description: str, total: int | None = None) -> Iterator[Item]:
        """Yields the items unchanged."""
        yield from items


class RichProgress:
    """A bar in the terminal; plain lines where the output is not a terminal are left to the log."""

    def track(self, items: Iterable[Item], description: str, total: int | None = None) -> Iterator[Item]:
        """Yields the items unchanged and draws a bar with rate and time left."""
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            ProgressColumn,
            Task,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )
        from rich.progress import Progress as Bar
        from rich.text import Text

        class RateColumn(ProgressColumn):
            def render(self, task: Task) -> Text:
                return Text(describe_rate(task.finished_speed or task.speed))

        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            RateColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
        )
        with Bar(*columns, console=Console(stderr=True), speed_estimate_period=_RATE_OVER) as bar:
            yield from bar.track(items, description=description, total=total)


_RATE_OVER = 300.0
"""Seconds that the rate is an average of: items of very different length come in rows."""


def describe_rate(per_second: float | None) -> str:
    """Items an hour where they are slow, a second where they are fast; empty for a rate not yet known."""
    if per_second is None:
        return ""
    return f"{per_second:.0f}/s" if per_second >= 10 else f"{3600 * per_second:,.0f}/h"
