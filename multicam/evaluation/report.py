"""One table of numbers, and its four forms: text, CSV, JSON and HTML."""

from __future__ import annotations

import csv
import html
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from multicam.files import write_json, write_text

Cell = str | float | int | None


@dataclass(frozen=True)
class Column:
    """A column: its heading and how many decimals its numbers show."""

    name: str
    decimals: int = 1


@dataclass(frozen=True)
class Table:
    """A table with a title and one line saying how to read it.

    Cells are text or numbers; None, NaN and infinity stand for "there is no such number" and show as a dash.
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"a row of table {self.title!r} has {len(row)} cells for {len(self.columns)} columns")

    def to_text(self) -> str:
        """Aligned columns for a terminal."""
        cells = [[c.name for c in self.columns], *self._formatted()]
        widths = [max(len(row[i]) for row in cells) for i in range(len(self.columns))]
        lines = ["  ".join(_pad(row[i], widths[i], self._numeric(i)) for i in range(len(widths))) for row in cells]
        lines.insert(1, "  ".join("-" * width for width in widths))
        note = [self.note] if self.note else []
        return "\n".join([self.title, *(line.rstrip() for line in lines), *note])

    def to_csv(self) -> str:
        """Full precision, one heading line; empty cells where there is no number."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow([c.name for c in self.columns])
        writer.writerows([_plain(cell) for cell in row] for row in self.rows)
        return out.getvalue()

    def to_plain(self) -> dict[str, Any]:
        """Title, note and rows as mappings from column name to value, ready for JSON."""
        names = [c.name for c in self.columns]
        rows = [dict(zip(names, map(_plain, row), strict=True)) for row in self.rows]
        return {"title": self.title, "note": self.note, "rows": rows}

    def to_html(self) -> str:
        """A <table> with a caption; numbers are marked with class "number"."""
        head = "".join(f"<th{self._mark(i)}>{html.escape(c.name)}</th>" for i, c in enumerate(self.columns))
        body = "".join(
            "<tr>" + "".join(f"<td{self._mark(i)}>{html.escape(cell)}</td>" for i, cell in enumerate(row)) + "</tr>"
            for row in self._formatted()
        )
        caption = f"<caption>{html.escape(self.title)}</caption>"
        note = f'<p class="note">{html.escape(self.note)}</p>' if self.note else ""
        return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{note}"

    def _formatted(self) -> list[list[str]]:
        return [[_format(cell, c.decimals) for cell, c in zip(row, self.columns, strict=True)] for row in self.rows]

    def _numeric(self, index: int) -> bool:
        return any(isinstance(row[index], int | float) for row in self.rows)

    def _mark(self, index: int) -> str:
        return ' class="number"' if self._numeric(index) else ""


def save_report(folder: Path, name: str, tables: Sequence[Table]) -> None:
    """Writes tables as folder/name.txt, name.json and, one each, name-<title in lower case>.csv."""
    write_text(folder / f"{name}.txt", render_text(tables))
    write_json(folder / f"{name}.json", [table.to_plain() for table in tables], indent=1)
    for table in tables:
        slug = "-".join("".join(c if c.isalnum() else " " for c in table.title.lower()).split())
        write_text(folder / f"{name}-{slug}.csv", table.to_csv())


def render_text(tables: Sequence[Table]) -> str:
    """All tables as text, one after the other."""
    return "\n\n".join(table.to_text() for table in tables) + "\n"


def mean_cell(cells: Iterable[Cell]) -> float:
    """Mean of the numbers among some cells of a column; infinite ones included, text and empty cells not."""
    numbers = [float(cell) for cell in cells if isinstance(cell, int | float)]
    return sum(numbers) / len(numbers) if numbers else math.nan


def _format(cell: Cell, decimals: int) -> str:
    value = _plain(cell)
    if value is None:
        return "-"
    return f"{value:.{decimals}f}" if isinstance(value, float) else str(value)


def _plain(cell: Cell) -> Cell:
    return None if isinstance(cell, float) and not math.isfinite(cell) else cell


def _pad(text: str, width: int, right: bool) -> str:
    return text.rjust(width) if right else text.ljust(width)
