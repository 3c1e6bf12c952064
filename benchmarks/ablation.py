"""What each ingredient of the registration is worth: one command, one table (docs/registration.md shows it).

    python benchmarks/ablation.py [--bench DIR] [--every 5] [--workers 2]

--every applies to YCB-V.

Each row leaves one ingredient out: the learning of the noise, the shape of the covariances (depth as certain as the
image plane), symmetries, the refit of a hypothesis on all that agrees with it, the joint refinement.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path

from registration import load_scorer, machine, parse
from rich.console import Console
from rich.table import Table

from multicam.bundle.levenberg import LevenbergConfig
from multicam.commands.register import RegisterConfig, register_groups
from multicam.matching.consensus import ConsensusConfig
from multicam.matching.noise import NoiseConfig
from multicam.progress import RichProgress
from multicam.registration import LearningConfig, RegistrationConfig

SETS = (("ycbv", "cosypose", 3), ("ycbv", "posecnn", 5), ("tless", "megapose", 4), ("lmo", "megapose", 3))
COLUMNS = {"placed": "placed %", "mean_t": "mean mm", "good": "good %", "false": "false %", "nees95": "nees95 %"}
WITHOUT = {
    "nothing": RegistrationConfig(),
    "learning": RegistrationConfig(),
    "shape of covariances": RegistrationConfig(noise=NoiseConfig(depth_ratio=1.0)),
    "symmetries": RegistrationConfig(),
    "refit": RegistrationConfig(consensus=ConsensusConfig(rounds=0)),
    "joint refinement": RegistrationConfig(solver=LevenbergConfig(iterations=0)),
}
"""What is left out, and the registration without it."""


def main() -> None:
    options = parse(__doc__, every=5)
    scorer = load_scorer(options.bench / "score.py")
    print(machine())
    table = Table("data", "estimates", "views", "without", *COLUMNS.values(), title="Ablation")
    for data, method, views in SETS:
        dataset = options.bench / data
        truth = scorer.Truth(dataset)
        # Errors of objects are not asked for here and take longer than the rest.
        truth.points = {}
        groups = json.loads((dataset / f"groups_{views}.json").read_text())
        groups["groups"] = groups["groups"][:: options.every if data == "ycbv" else 1]
        for name, registration in WITHOUT.items():
            with tempfile.TemporaryDirectory() as folder:
                config = RegisterConfig(
                    without_symmetries(dataset, Path(folder)) if name == "symmetries" else dataset,
                    next((dataset / "results").glob(f"{method}*")),
                    Path(folder) / "groups.json",
                    Path(folder) / "predictions.json",
                    workers=options.workers,
                    registration=registration,
                )
                if name == "learning":
                    config = replace(config, learning=LearningConfig(rounds=0))
                config.groups.write_text(json.dumps(groups))
                register_groups(config, RichProgress())
                figures = scorer.score(truth, groups, json.loads(config.output.read_text()))
            cells = [f"{figures[column]:.1f}" if column in figures else "" for column in COLUMNS]
            table.add_row(data, method, str(views), name, *cells)
    Console(width=120).print(table)


def without_symmetries(dataset: Path, folder: Path) -> Path:
    """A copy of a data set's cameras and models in which no object is symmetric."""
    source = next(
        path for path in (dataset / "models_info.json", dataset / "models/models_info.json") if path.is_file()
    )
    info = json.loads(source.read_text())
    for model in info.values():
        model.pop("symmetries_discrete", None)
        model.pop("symmetries_continuous", None)
    copy = folder / "dataset"
    copy.mkdir()
    (copy / "models_info.json").write_text(json.dumps(info))
    (copy / "test").symlink_to((dataset / "test").resolve())
    return copy


if __name__ == "__main__":
    main()
