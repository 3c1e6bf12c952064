"""`multicam demo`: the shipped network on the shipped three-camera recording, then the errors against its truth."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from rich.console import Console

from multicam.commands.evaluate import evaluate_recorded
from multicam.commands.run import RunConfig, run
from multicam.config import parse_command
from multicam.errors import DataError
from multicam.fitting.config import FitConfig
from multicam.progress import RichProgress

NETWORK, RECORDING = "instruments.onnx", "recording"
"""Names within the package's assets."""


@dataclass(frozen=True)
class DemoConfig:
    """Nothing to prepare: network and recording come with the package."""

    output: Path = Path("output/demo")
    """Folder for the results and the page."""


def main(argv: list[str]) -> None:
    """Runs, evaluates, and prints the tables and the page's path."""
    config = parse_command(DemoConfig, argv, "multicam demo", "The shipped network on the shipped recording.")
    assets = resources.files("multicam") / "assets"
    for name in (NETWORK, RECORDING):
        if not (assets / name).is_file() and not (assets / name).is_dir():
            raise DataError(f"the demo's {name} is not part of this installation: {assets / name} does not exist.")
    console, progress = Console(highlight=False, markup=False, soft_wrap=True), RichProgress()
    with ExitStack() as stack:
        network, recording = (stack.enter_context(resources.as_file(assets / name)) for name in (NETWORK, RECORDING))
        run(RunConfig(recording, network, config.output, fit=FitConfig(enabled=True)), progress)
        console.print(evaluate_recorded(config.output, None, config.output, progress))
    console.print(f"\nReport: {config.output / 'report.html'}")
