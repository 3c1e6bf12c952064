"""`multicam train`: a configuration in, checkpoints out."""

from __future__ import annotations

from multicam.config import parse_command
from multicam.progress import RichProgress
from train.config import TrainConfig
from train.fit import fit

_DESCRIPTION = (
    "Trains a keypoint detector on BOP folders. Ctrl-C saves; --resume continues. "
    "For several GPUs: torchrun --nproc-per-node N -m train.cli --config FILE.yaml."
)


def main(argv: list[str]) -> None:
    """Trains as the configuration says.

    Raises:
        MulticamError: a mistake in configuration or data.
        KeyboardInterrupt: stopped by a signal, after saving.
    """
    fit(parse_command(TrainConfig, argv, prog="multicam train", description=_DESCRIPTION), RichProgress())


if __name__ == "__main__":
    import sys

    from multicam.cli import run as run_command

    sys.exit(run_command(["train", *sys.argv[1:]]))
