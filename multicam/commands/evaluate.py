"""`multicam evaluate`: errors of a run, or of single-view estimates, against ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from multicam.commands.run import ESTIMATES, RESULTS, write_report
from multicam.config import parse_command
from multicam.dataset.objects import load_catalogue
from multicam.dataset.results import read_results
from multicam.dataset.runs import read_run
from multicam.dataset.sequence import load_recording
from multicam.errors import ConfigError
from multicam.evaluation.report import Table, render_text, save_report
from multicam.evaluation.run_error import evaluate_run
from multicam.evaluation.single_view import evaluate_estimates, read_split, single_view_table
from multicam.evaluation.tables import camera_table, coverage_table, object_table, statements, time_table
from multicam.files import require_folder
from multicam.progress import Progress, RichProgress


@dataclass(frozen=True)
class EvaluateConfig:
    """Give either a run, or candidates with their data set."""

    run: Path | None = None
    """Folder written by `multicam run`; its report.html is written again, with the errors."""
    recording: Path | None = None
    """The run's recording, if it has moved since."""
    candidates: Path | None = None
    """Single-view estimates in BOP results format (CSV, or gzipped)."""
    dataset: Path | None = None
    """BOP data set of the candidates: models/ and splits."""
    split: str = "test"
    """Split of the data set."""
    output: Path | None = None
    """Folder for evaluation.txt, .json and .csv; beside the run or the candidates if not given."""


def main(argv: list[str]) -> None:
    """Parses the flags, evaluates and prints the tables.

    Raises:
        ConfigError: the flags name neither a run nor candidates with their data set, or both.
    """
    config = parse_command(EvaluateConfig, argv, "multicam evaluate", "Errors of poses against ground truth.")
    console = Console(highlight=False, markup=False, soft_wrap=True)
    if config.run is not None and config.candidates is None:
        console.print(evaluate_recorded(config.run, config.recording, config.output or config.run, RichProgress()))
        console.print(f"\nReport: {config.run / 'report.html'}")
    elif config.run is None and config.candidates is not None and config.dataset is not None:
        output = config.output or config.candidates.parent
        table = evaluate_candidates(config.candidates, config.dataset, config.split, RichProgress())
        save_report(output, "evaluation", [table])
        console.print(render_text([table]))
    else:
        raise ConfigError("give either --run DIR, or --candidates results.csv together with --dataset DIR.")


def evaluate_recorded(folder: Path, recording_folder: Path | None, output: Path, progress: Progress) -> str:
    """Judges a run against the truth of its recording; writes the tables and the page again.

    Returns:
        Tables and statements as text.

    Raises:
        DataError: no run there, no truth in the recording, or the two do not belong together.
    """
    run = read_run(require_folder(folder, "run folder") / RESULTS)
    recording = load_recording(recording_folder or run.recording)
    errors = evaluate_run(run, read_results(folder / ESTIMATES), recording, progress)
    catalogue = recording.catalogue
    tables: Sequence[Table] = [
        camera_table(run, errors), coverage_table(run), time_table(run), object_table(errors, catalogue),
        single_view_table(errors.single_view, catalogue),
    ]  # fmt: skip
    save_report(output, "evaluation", tables)
    write_report(folder, run, recording, errors, progress)
    facts, warnings = statements(run, errors, catalogue)
    return render_text(tables) + "\n" + "\n".join([*facts, *(f"Warning: {text}" for text in warnings)])


def evaluate_candidates(candidates: Path, dataset: Path, split: str, progress: Progress) -> Table:
    """Judges single-view estimates against a split.

    Raises:
        DataError: files missing or malformed, or estimates that do not belong to the split.
    """
    estimates = read_results(candidates)
    catalogue = load_catalogue(require_folder(dataset, "data set folder"))
    records = read_split(dataset / split, estimates)
    return single_view_table(evaluate_estimates(estimates, records, catalogue, progress), catalogue)
