"""`multicam datagen inspect`: a data set or a models folder on one HTML page."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

from multicam.config import parse_command
from multicam.progress import Progress, RichProgress

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class InspectConfig:
    """Options of `multicam datagen inspect`."""

    data: Path
    """Data set folder (models/ and splits) or BOP models folder; may stand first, without the flag."""
    output: Path | None = None
    """HTML file; inspect.html in the folder if left out."""


def main(argv: list[str]) -> None:
    """Runs the command."""
    if argv and not argv[0].startswith("-"):
        argv = ["--data", *argv]
    config = parse_command(
        InspectConfig,
        argv,
        "multicam datagen inspect",
        "Shows objects with dimensions, keypoints and symmetries, and labelled pictures, on one HTML page.",
    )
    write_inspection(config.data, RichProgress(), config.output)


def write_inspection(data: Path, progress: Progress, output: Path | None = None) -> None:
    """Writes the sheet of a folder, as inspect.html into it if no file is given.

    Raises:
        DataError: no models there, or something that does not follow the BOP format.
    """
    from datagen.sheets.page import write_sheet

    target = output or data / "inspect.html"
    write_sheet(data, target, progress)
    _LOG.info("wrote %s", target)
