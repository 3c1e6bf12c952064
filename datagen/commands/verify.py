"""`multicam datagen verify`: is a rendered data set what its manifests say?"""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass
from pathlib import Path

from multicam.config import parse_command
from multicam.errors import ConfigError, DataError
from multicam.progress import Progress, RichProgress

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class VerifyConfig:
    """Options of `multicam datagen verify`."""

    data: Path
    """Data set folder with splits that `multicam datagen render` made, or one such split."""
    workers: int = 0
    """Threads that read and hash; 0 for one per core."""

    def __post_init__(self) -> None:
        if self.workers < 0:
            raise ConfigError(f"workers is {self.workers}; give how many, or 0 for one per core.")


def main(argv: list[str]) -> None:
    """Runs the command; the folder may also be given without --data."""
    if argv and not argv[0].startswith("-"):
        argv = ["--data", *argv]
    config = parse_command(
        VerifyConfig,
        argv,
        "multicam datagen verify",
        "Compares a rendered data set with its manifests: missing, torn, extra and doubled files and labels.",
    )
    verify(config, RichProgress())


def verify(config: VerifyConfig, progress: Progress) -> None:
    """Compares every split with its manifests, and says what is wrong.

    Raises:
        DataError: something is wrong, or there is nothing to verify.
    """
    from datagen.jobs.verify import find_splits, verify_split

    count = 0
    for split in find_splits(config.data):
        report = verify_split(split, config.workers or os.cpu_count() or 1, progress)
        _LOG.info("%s: %d pictures in %d scenes, %d files", split, report.pictures, report.scenes, report.files)
        for problem in report.problems:
            _LOG.warning("%s", problem)
        count += len(report.problems)
    if count:
        raise DataError(
            f"{config.data} is not as its manifests say: {count} problems, named above. A scene that is "
            "damaged is made anew when its folder is deleted and the data set rendered again."
        )
