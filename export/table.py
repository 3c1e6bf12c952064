"""`multicam export table`: parameters, operations and time of networks of every size, before one is trained."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
import onnxruntime as ort

from export.to_onnx import write_onnx
from export.wrapper import DeployDetector
from models.config import ModelConfig, NeckName, Size
from models.detector import Detector
from models.profile import profile
from multicam.config import parse_command
from multicam.dataset.objects import ObjectModel
from multicam.errors import ConfigError
from multicam.evaluation.report import Cell, Column, Table
from multicam.files import write_text
from multicam.geometry.symmetry import Symmetries
from multicam.inference.metadata import NetworkMetadata
from multicam.inference.providers import available_providers, require_provider
from multicam.inference.session import Network, SessionConfig
from multicam.progress import Progress, RichProgress

BATCHES = (1, 3)
"""Views that are timed together: one, and as many as the demo has."""

_WARM_UP = 2
"""Runs that are not counted."""


@dataclass(frozen=True)
class TableConfig:
    """Networks to list, and on what to time them."""

    sizes: tuple[Size, ...] = get_args(Size)
    """Sizes to list."""
    necks: tuple[NeckName, ...] = get_args(NeckName)
    """Necks to list."""
    timed: tuple[Size, ...] = ("nano", "tiny", "s")
    """Sizes to time; the larger ones take minutes on a CPU. `--timed` with nothing after it times none."""
    width: int = 640
    """Width of the input, pixels, a multiple of 32."""
    height: int = 640
    """Height of the input, pixels, a multiple of 32."""
    classes: int = 9
    """Object classes; they hardly matter."""
    keypoints: int = 8
    """Keypoints of each object."""
    rows: int = 100
    """Best cells of each image that are decoded."""
    providers: tuple[str, ...] = ()
    """Execution providers to time on; cpu, and cuda where this ONNX Runtime has it, if none is given."""
    threads: int = 0
    """CPU threads of one operator; 0 takes all cores."""
    rounds: int = 20
    """Runs of each batch, of which the fastest counts: what else a machine does only adds to the others."""
    output: Path | None = None
    """File to write: .md, .csv or .txt; without it the table is only shown."""

    def __post_init__(self) -> None:
        if self.width % 32 or self.height % 32 or min(self.width, self.height) < 64:
            raise ConfigError(
                f"the input must be at least 64 and a multiple of 32 on each side; {self.width} x {self.height} is not."
            )
        if min(self.classes, self.rows, self.rounds) < 1 or self.keypoints < 4:
            raise ConfigError("classes, rows and rounds must be 1 or more, keypoints 4 or more.")
        if self.output is not None and self.output.suffix not in _FORMATS:
            raise ConfigError(f"the output must end in {', '.join(_FORMATS)}; it is {self.output}.")


def main(argv: list[str]) -> None:
    """Shows the table, and writes it where asked.

    Raises:
        MulticamError: an unusable configuration, or an execution provider that is not there.
    """
    description = "Lists parameters, floating-point operations and ONNX Runtime's time of networks of every size."
    config = parse_command(TableConfig, argv, "multicam export table", description)
    table = make_table(config, RichProgress())
    sys.stdout.write(table.to_text() + "\n")
    if config.output:
        write_text(config.output, _FORMATS[config.output.suffix](table) + "\n")


def make_table(config: TableConfig, progress: Progress) -> Table:
    """One row per network, PAFPN first; a dash where a network is not timed.

    Raises:
        ModelError: an execution provider that is not there.
    """
    providers = _providers(config)
    networks = [
        ModelConfig(config.classes, size, neck, config.keypoints) for neck in config.necks for size in config.sizes
    ]
    rows = [_row(network, providers, config) for network in progress.track(networks, "networks", len(networks))]
    columns = [Column("size"), Column("neck"), Column("parameters, M", 2), Column("GFLOPs", 2)]
    columns += [
        Column(f"{name}, {batch} view{'s' if batch > 1 else ''}, ms") for name in providers for batch in BATCHES
    ]
    note = (
        f"Deployed form, {config.classes} classes, {config.keypoints} keypoints; FLOPs of one picture, a "
        "multiplication with its addition is 2."
    )
    if providers:
        threads = config.threads or os.cpu_count()
        note += f" fp32, fastest of {config.rounds} runs, ONNX Runtime {ort.__version__}, {threads} CPU threads."
    return Table(f"Networks at {config.width} x {config.height}", tuple(columns), tuple(rows), note)


def to_markdown(table: Table) -> str:
    """A table as Markdown, its note below it."""
    names = [column.name for column in table.columns]
    lines = [names, ["---"] * len(names), *(_shown(row, table.columns) for row in table.rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + f"\n\n{table.note}"


def _shown(row: Sequence[Cell], columns: Sequence[Column]) -> list[str]:
    return [
        "-" if cell is None else f"{cell:.{column.decimals}f}" if isinstance(cell, float) else str(cell)
        for cell, column in zip(row, columns, strict=True)
    ]


_FORMATS = {".md": to_markdown, ".csv": lambda table: table.to_csv().rstrip(), ".txt": Table.to_text}
"""Suffix of the output to what writes it."""


def _providers(config: TableConfig) -> tuple[str, ...]:
    if not config.timed:
        return ()
    providers = config.providers or tuple(name for name in ("cpu", "cuda") if name in available_providers())
    for name in providers:
        require_provider(name)
    return providers


def _row(network: ModelConfig, providers: Sequence[str], config: TableConfig) -> tuple[Cell, ...]:
    cost = profile(network, config.width, config.height, config.rows)
    times: list[Cell] = [None] * (len(providers) * len(BATCHES))
    if network.size in config.timed:
        times = list(_times(network, providers, config))
    return (network.size, network.neck, cost.parameters / 1e6, cost.flops / 1e9, *times)


def _times(network: ModelConfig, providers: Sequence[str], config: TableConfig) -> list[float]:
    """Milliseconds of each provider and batch, of a network with random weights."""
    keypoints = np.linspace(-0.03, 0.03, config.keypoints)[:, np.newaxis].repeat(3, axis=1)
    objects = tuple(
        ObjectModel(i, f"object {i}", 0.1, Symmetries(), keypoints=keypoints) for i in range(config.classes)
    )
    metadata = NetworkMetadata(objects, config.width, config.height, "none")
    cells = sum((config.width // stride) * (config.height // stride) for stride in network.strides)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "network.onnx"
        write_onnx(DeployDetector(Detector(network), min(config.rows, cells)), metadata, path)
        opened = [Network(path, SessionConfig(provider, config.threads)) for provider in providers]
        return [milliseconds for one in opened for milliseconds in _time(one, config.rounds)]


def _time(network: Network, rounds: int) -> list[float]:
    """Milliseconds of each batch in its fastest run; the batches take turns, so that other work meets them alike."""
    shape = network.metadata.height, network.metadata.width, 3
    inputs = [np.random.default_rng(0).integers(0, 256, (batch, *shape), dtype=np.uint8) for batch in BATCHES]
    seconds: list[list[float]] = [[] for _ in inputs]
    for _ in range(_WARM_UP + rounds):
        for batch, found in zip(inputs, seconds, strict=True):
            began = time.perf_counter()
            network.run(batch)
            found.append(time.perf_counter() - began)
    return [1000 * min(found[_WARM_UP:]) for found in seconds]
