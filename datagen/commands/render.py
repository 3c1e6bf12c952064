"""`multicam datagen render`: a labelled data set of random scenes."""

from __future__ import annotations

from dataclasses import replace

from datagen.config import DatagenConfig
from multicam.config import parse_command
from multicam.progress import RichProgress


def main(argv: list[str]) -> None:
    """Runs the command with its own flags."""
    config = parse_command(
        DatagenConfig,
        argv,
        prog="multicam datagen render",
        description="Renders labelled pictures of known objects into a BOP data set; run again to continue.",
    )
    from datagen.commands.import_parts import import_folder
    from datagen.commands.inspect import write_inspection
    from datagen.jobs.generate import generate

    progress = RichProgress()
    generate(replace(config, models=import_folder(config.models, config.output, progress)), progress)
    write_inspection(config.output, progress)
