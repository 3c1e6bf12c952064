"""The subcommands of `multicam`: where each lives and what it needs. Importing this imports none of them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Subcommand:
    """One verb of the command line.

    Attributes:
        module: where its `main(argv)` lives; a name outside `multicam` needs a checkout of the repository.
        summary: one line for the overview.
        extra: the optional dependencies it needs, or None for the runtime alone.
    """

    module: str
    summary: str
    extra: str | None = None


SUBCOMMANDS = {
    "datagen": Subcommand("datagen.cli", "render synthetic training data and recordings from CAD models", "datagen"),
    "train": Subcommand("train.cli", "train a keypoint detector on BOP folders", "train"),
    "export": Subcommand("export.cli", "write a trained detector as ONNX, checked against PyTorch", "export"),
    "run": Subcommand("multicam.commands.run", "camera and object poses from a recording of several cameras"),
    "register": Subcommand("multicam.commands.register", "camera poses of view groups from single-view estimates"),
    "evaluate": Subcommand("multicam.commands.evaluate", "errors of a run or of estimates against ground truth"),
    "demo": Subcommand("multicam.commands.demo", "the shipped network on the shipped three-camera recording"),
    "doctor": Subcommand("multicam.commands.doctor", "versions, and what each subcommand still needs"),
}
