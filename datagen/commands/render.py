"""`multicam datagen render`: a labelled data set of random scenes."""

from __future__ import annotations

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
    from datagen.pictures.generate import generate

    generate(config, RichProgress())
