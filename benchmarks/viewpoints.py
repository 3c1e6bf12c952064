"""Time and size of sparse viewpoint models: one command, one table.

    python benchmarks/viewpoints.py [--bench DIR] [--every N]

"first" generates and saves a model; CPU seconds are those of all cores together, and on an idle machine the wall clock
shows them divided by its cores. "again" is a load from the cache, "pick" the search for the closest view of a pose with
a look at its points. M3T takes 24 to 30 s for a region and a depth model of 2562 views on two cores of this kind.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from registration import machine
from rich.console import Console
from rich.table import Table

from multicam.bundle.viewpoints.cache import load_viewpoints
from multicam.bundle.viewpoints.generate import ViewpointConfig, generate
from multicam.geometry import se3
from multicam.geometry.mesh import load_mesh

SETS = (("lmo", 0.001), ("ycbv", 1.0))
"""Folders below the bench and metres per unit of their models."""

PICKS = 1000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--bench", type=Path, default=Path(__file__).resolve().parents[2] / "shared" / "bench")
    parser.add_argument("--every", type=int, default=1, help="take one object in so many")
    options = parser.parse_args()
    print(machine())
    columns = ("faces", "first s", "CPU s", "again ms", "pick us", "MB")
    table = Table("object", *columns, title="Viewpoint models, 2562 views of 200 + 200 points")
    rows: list[list[float]] = []
    for name, unit in SETS:
        for path in sorted((options.bench / name / "models").glob("obj_*"))[:: options.every]:
            rows.append(measure(path, unit))
            table.add_row(f"{name} {path.stem}", *texts(rows[-1]))
    table.add_row("median", *texts(np.median(rows, axis=0)))
    table.add_row("largest", *texts(np.max(rows, axis=0)))
    Console().print(table)


def texts(row: Iterable[float]) -> list[str]:
    return [f"{value:.0f}" if value >= 100 else f"{value:.2g}" for value in row]


def measure(path: Path, unit: float) -> list[float]:
    """One row of the table."""
    with tempfile.TemporaryDirectory() as folder:
        meshes = {0: load_mesh(path, unit, Path(folder))}
        # The first one compiles.
        generate(meshes[0], ViewpointConfig(subdivisions=1))
        began, cpu = time.perf_counter(), time.process_time()
        load_viewpoints(meshes, ViewpointConfig(), folder=Path(folder))
        seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
        size = sum(file.stat().st_size for file in (Path(folder) / "viewpoints").iterdir())
        began = time.perf_counter()
        model = load_viewpoints(meshes, ViewpointConfig(), folder=Path(folder))[0]
        again = time.perf_counter() - began
        poses = se3.exp(np.random.default_rng(0).normal(size=(PICKS, 6)))
        began = time.perf_counter()
        for pose in poses:
            view = model.closest_view(pose)
            model.contour_point[view].sum()
        pick = time.perf_counter() - began
    return [len(meshes[0].faces), seconds, cpu, 1000 * again, 1e6 * pick / PICKS, size / 1e6]


if __name__ == "__main__":
    main()
