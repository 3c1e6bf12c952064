"""`multicam train`: a configuration in, checkpoints out; `multicam train new` writes a configuration."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields

from rich.console import Console

from multicam.config import parse_command
from multicam.errors import ConfigError, DataError
from multicam.progress import RichProgress
from train.config import TrainConfig

_DESCRIPTION = (
    "Trains a keypoint detector on BOP folders. Ctrl-C saves; --resume continues. "
    "`multicam train new --models DIR` writes a configuration for parts of your own. "
    "For several GPUs: torchrun --nproc-per-node N -m train.cli --config FILE.yaml."
)


@dataclass(frozen=True)
class TrainCommand(TrainConfig):
    """A run, or one of two looks at it before it begins."""

    dry_run: bool = False
    """Measure a few steps, say what the run will cost and what limits it, and write nothing."""
    sanity: bool = False
    """Learn eight pictures by heart, say whether that works, and write output/sanity.jpg."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.dry_run and self.sanity:
            raise ConfigError("--dry-run and --sanity are two commands; give one of them.")

    @property
    def run(self) -> TrainConfig:
        """The run alone."""
        return TrainConfig(**{field.name: getattr(self, field.name) for field in fields(TrainConfig)})


def main(argv: list[str]) -> None:
    """Trains as the configuration says, or looks at the run, or writes a configuration.

    Raises:
        MulticamError: a mistake in configuration or data, or a sanity check that failed.
        KeyboardInterrupt: stopped by a signal, after saving.
    """
    if argv and argv[0] == "new":
        from train.new import main as new

        new(argv[1:])
        return
    command = parse_command(TrainCommand, argv, prog="multicam train", description=_DESCRIPTION)
    processes = int(os.environ.get("WORLD_SIZE", "1"))
    if processes > 1 and (command.dry_run or command.sanity):
        raise ConfigError(f"--dry-run and --sanity look at one process; torchrun started {processes}, run without it.")
    if command.dry_run:
        from train.dry_run import dry_run

        Console().print(dry_run(command.run, RichProgress()))
    elif command.sanity:
        from train.sanity import sanity_check

        verdict = sanity_check(command.run, RichProgress())
        Console().print(verdict.describe(), highlight=False)
        if not verdict.passed:
            raise DataError(f"the sanity check failed: {verdict.reason()}")
    else:
        from train.fit import fit

        fit(command.run, RichProgress())


if __name__ == "__main__":
    import sys

    from multicam.cli import run as run_command

    sys.exit(run_command(["train", *sys.argv[1:]]))
