"""`multicam evaluate`: errors of a run, of single-view estimates or of a network, against ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from rich.console import Console

from multicam.commands.candidates import read_candidates
from multicam.commands.evaluate_split import PAGE, ask_network, by_image, limited, report_split
from multicam.commands.run import ESTIMATES, RESULTS, UNCERTAIN, write_report
from multicam.config import parse_command, save_config
from multicam.dataset.objects import load_catalogue
from multicam.dataset.results import Estimates, read_results, write_results
from multicam.dataset.runs import read_run
from multicam.dataset.sequence import load_recording
from multicam.errors import ConfigError, DataError
from multicam.evaluation.points import PointSets
from multicam.evaluation.report import Table, render_text, save_report
from multicam.evaluation.run_error import evaluate_run
from multicam.evaluation.selection import LEAST_VISIBLE, Selection
from multicam.evaluation.single_view import read_split
from multicam.evaluation.single_view_tables import single_view_table
from multicam.evaluation.split_error import evaluate_split
from multicam.evaluation.tables import (
    adjustment_table,
    board_table,
    camera_table,
    coverage_table,
    object_table,
    statements,
    time_table,
)
from multicam.files import require_folder
from multicam.inference.estimator import EstimatorConfig
from multicam.inference.session import SessionConfig
from multicam.progress import Progress, RichProgress

CONFIG = "evaluation.config.yaml"
"""The resolved configuration, beside the figures of a split."""

Stage = Literal["all", "network", "graph", "bundle"]


@dataclass(frozen=True)
class EvaluateConfig:
    """Give one of a run, candidates with their data set, or a network with a data set."""

    run: Path | None = None
    """Folder written by `multicam run`; its report.html is written again, with the errors."""
    recording: Path | None = None
    """The run's recording, if it has moved since."""
    stage: Stage = "all"
    """Of a run, print the figures of one stage alone: the network's in single pictures, those of the scene graph, or
    cameras and objects before and after bundle adjustment."""
    candidates: Path | None = None
    """Single-view estimates in BOP results format (CSV, or gzipped)."""
    network: Path | None = None
    """Network file written by `multicam export`; it and PnP are run on the images, and estimates.csv is written,
    as BOP has it, and estimates_covariance.csv, from which `multicam register` also learns how sure each one is."""
    dataset: Path | None = None
    """BOP data set of the candidates or for the network: models/ and splits."""
    split: str = "test"
    """Split of the data set."""
    limit: int | None = None
    """Judge at most this many images, evenly spread over the split."""
    distance: tuple[float, float] | None = None
    """Judge only objects that are this far from the camera, metres: from the first number up to the second."""
    least_visible: float = LEAST_VISIBLE
    """Judge only objects of which at least this fraction is seen."""
    output: Path | None = None
    """Folder for the figures; beside the run or the candidates if not given, runs/evaluate for a network."""
    session: SessionConfig = field(default_factory=SessionConfig)
    """Where the network runs."""
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    """From pixels to poses."""

    @property
    def selection(self) -> Selection:
        """The objects to judge."""
        return Selection(*(self.distance or ()), least_visible=self.least_visible)


def main(argv: list[str]) -> None:
    """Parses the flags, evaluates and prints the tables.

    Raises:
        ConfigError: the flags name none or several of run, candidates and network, or no data set.
    """
    config = parse_command(EvaluateConfig, argv, "multicam evaluate", "Errors of poses against ground truth.")
    console = Console(highlight=False, markup=False, soft_wrap=True)
    given = sum(path is not None for path in (config.run, config.candidates, config.network))
    if given == 1 and config.run is not None:
        output = config.output or config.run
        console.print(evaluate_recorded(config.run, config.recording, output, RichProgress(), config.stage))
        console.print(f"\nReport: {config.run / 'report.html'}")
    elif given == 1 and config.dataset is not None:
        beside = Path("runs/evaluate") if config.candidates is None else config.candidates.parent
        folder = config.output or beside
        console.print(evaluate_dataset(config, config.dataset, folder, RichProgress()))
        console.print(f"\nReport: {folder / PAGE}")
    else:
        raise ConfigError(
            "give either --run DIR, or --candidates results.csv together with --dataset DIR, or --network net.onnx "
            "together with --dataset DIR."
        )


def evaluate_recorded(
    folder: Path, recording_folder: Path | None, output: Path, progress: Progress, stage: Stage = "all"
) -> str:
    """Judges a run against the truth of its recording; writes the tables and the page again.

    Returns:
        Tables and statements as text; of one stage its tables alone.

    Raises:
        DataError: no run there, no truth in the recording, the two do not belong together, or no step was adjusted.
    """
    run = read_run(require_folder(folder, "run folder") / RESULTS)
    recording = load_recording(recording_folder or run.recording)
    errors = evaluate_run(run, read_results(folder / ESTIMATES), recording, progress)
    catalogue = recording.catalogue
    stages: dict[Stage, list[Table]] = {
        "graph": [camera_table(run, errors), coverage_table(run), time_table(run), object_table(errors, catalogue)],
        "bundle": [] if errors.adjustment is None else [adjustment_table(errors.adjustment)],
        "network": [single_view_table(errors.single_view, catalogue)],
    }
    if errors.board:
        stages["graph"].insert(1, board_table(errors.board, run.headset))
    tables: Sequence[Table] = [table for part in stages.values() for table in part]
    save_report(output, "evaluation", tables)
    write_report(folder, run, recording, errors, progress)
    if stage != "all":
        if not stages[stage]:
            raise DataError(
                f"no step of {folder} was adjusted: bundle adjustment wants depth in some camera, or "
                "--pipeline.bundle.without-depth at `multicam run`."
            )
        return render_text(stages[stage])
    facts, warnings = statements(run, errors, catalogue)
    return render_text(tables) + "\n" + "\n".join([*facts, *(f"Warning: {text}" for text in warnings)])


def evaluate_dataset(config: EvaluateConfig, dataset: Path, folder: Path, progress: Progress) -> str:
    """Judges candidates or a network against a split; writes the figures and the page.

    Returns:
        Tables and statements as text.

    Raises:
        DataError: files missing or malformed, or estimates that do not belong to the split.
        ModelError: not a network of ours, or one for other objects.
        ConfigError: a selection that holds nothing.
    """
    selection = config.selection
    catalogue = load_catalogue(require_folder(dataset, "data set folder"))
    split = dataset / config.split
    given: Estimates = {} if config.candidates is None else read_candidates(config.candidates, catalogue)
    records = limited(read_split(split, given), config.limit)
    subtitle = [f"Estimates {config.candidates}", f"Pictures {split}"]
    if config.network is None:
        errors = evaluate_split(records, given, None, PointSets(catalogue), selection, progress)
    else:
        rows, answers = ask_network(
            config.network, config.session, config.estimator, records, catalogue, dataset / "models", progress
        )
        subtitle[0] = f"Network {config.network}"
        errors = evaluate_split(records, by_image(rows), answers, PointSets(catalogue), selection, progress)
        write_results(folder / ESTIMATES, rows)
        write_results(folder / UNCERTAIN, rows, covariances=True)
    save_config(config, folder / CONFIG)
    return report_split(folder, errors, subtitle, progress)
