"""`multicam datagen sequence`: a recording of one moving and two static cameras."""

from __future__ import annotations

from datagen.recordings.config import SequenceConfig
from multicam.config import parse_command
from multicam.progress import RichProgress


def main(argv: list[str]) -> None:
    """Runs the command with its own flags."""
    config = parse_command(
        SequenceConfig,
        argv,
        prog="multicam datagen sequence",
        description="Renders a recording of a moving headset and two static cameras; run again to continue.",
    )
    from datagen.recordings.record import record

    record(config, RichProgress())
