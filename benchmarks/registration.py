"""Registration on published estimates: one command, one table.

    python benchmarks/registration.py [--bench DIR] [--every 10] [--workers 2]

DIR (default: $MULTICAM_BENCH, or shared/bench beside the checkout) holds score.py, the neutral scorer, and a folder for
each data set with models_info.json, test/, results/*.csv.gz and groups_N.json. Sets that are absent are left out. Times
are taken inside `register_views`; use --workers 1 on a quiet machine to compare them.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import json
import os
import platform
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import scipy
from rich.console import Console
from rich.table import Table

from multicam.commands.register import RegisterConfig, register_groups
from multicam.progress import RichProgress

COLUMNS = {
    "placed": "placed %",
    "mean_t": "mean mm",
    "mean_r": "mean deg",
    "median_t": "median mm",
    "good": "good %",
    "fine": "fine %",
    "false": "false %",
    "nees95": "nees95 %",
    "adds_auc": "ADD-S",
    "add_s_auc": "ADD(-S)",
    "ms_median": "ms",
    "ms_p95": "ms p95",
}
"""Figure of the scorer to heading."""


def main() -> None:
    options = parse(__doc__)
    print(machine())
    table = Table("data", "estimates", "views", "groups", *COLUMNS.values(), title="Registration")
    scorer = load_scorer(options.bench / "score.py")
    for dataset in sorted({path.parent for path in options.bench.glob("*/groups_*.json")}):
        for row in rows_of(dataset, scorer, options.every, options.workers):
            table.add_row(*row)
    Console(width=170).print(table)


def parse(description: str | None, every: int = 1) -> argparse.Namespace:
    """The options that all benchmarks on this data share."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bench", type=Path, default=default_bench())
    parser.add_argument("--every", type=int, default=every, help="use every n-th group only")
    parser.add_argument("--workers", type=int, default=1)
    return parser.parse_args()


def rows_of(dataset: Path, scorer: ModuleType, every: int, workers: int) -> list[list[str]]:
    """One row for each results file and group size; where the data set has pictures, one more with them."""
    truth = scorer.Truth(dataset)
    rows: list[list[str]] = []
    sources = sorted((dataset / "results").glob("*.csv*"))
    given = (False, True) if any(dataset.glob("test/*/rgb")) else (False,)
    for candidates, pictures in itertools.product(sources, given):
        for groups_file in sorted(dataset.glob("groups_*.json"), key=lambda path: int(path.stem[7:])):
            groups = json.loads(groups_file.read_text())
            groups["groups"] = groups["groups"][::every]
            figures = scorer.score(truth, groups, register(dataset, candidates, groups, workers, pictures), 4)
            cells = [f"{figures[name]:.2f}" if name in figures else "" for name in COLUMNS]
            rows.append(
                [
                    dataset.name,
                    candidates.name.split("_")[0] + (" + pictures" if pictures else ""),
                    groups_file.stem[7:],
                    str(figures["groups"]),
                    *cells,
                ]
            )
    return rows


def register(
    dataset: Path, candidates: Path, groups: dict[str, Any], workers: int, pictures: bool = False
) -> dict[str, Any]:
    """The predictions for some groups, by way of the command's own function."""
    with tempfile.TemporaryDirectory() as folder:
        chosen, output = Path(folder) / "groups.json", Path(folder) / "predictions.json"
        chosen.write_text(json.dumps(groups))
        config = RegisterConfig(dataset, candidates, chosen, output, pictures=pictures, workers=workers)
        register_groups(config, RichProgress())
        return json.loads(output.read_text())


def load_scorer(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("score", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def default_bench() -> Path:
    beside = Path(__file__).resolve().parents[2] / "shared" / "bench"
    return Path(os.environ.get("MULTICAM_BENCH", beside))


def machine() -> str:
    model = next(
        (line.split(":")[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line),
        platform.processor(),
    )
    load = os.getloadavg()[0]
    return (
        f"{model}, {os.cpu_count()} cores (load {load:.1f}); Python {platform.python_version()}, "
        f"NumPy {np.__version__}, SciPy {scipy.__version__}"
    )


if __name__ == "__main__":
    main()
