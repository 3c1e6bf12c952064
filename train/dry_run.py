"""`multicam train --dry-run`: what a run will cost, on a page; nothing is written."""

from __future__ import annotations

import os

from rich.console import Group, RenderableType
from rich.table import Table

from multicam.progress import Progress
from train.config import TrainConfig
from train.measure import Costs, StageCost, measure

_WAITING = 0.1
"""Share of a step spent waiting for pictures from which the loader is said to limit the run."""


def dry_run(config: TrainConfig, progress: Progress) -> RenderableType:
    """Measures a few steps of each stage and describes the whole run.

    Raises:
        MulticamError: whatever would stop the run itself.
    """
    return describe(config, measure(config, progress))


def describe(config: TrainConfig, costs: Costs) -> RenderableType:
    """Shapes, parameters, memory, rates, time and disk as tables and sentences."""
    return Group(_shapes(costs), _parts(costs), describe_stages(costs), *_sentences(config, costs))


def limit(stage: StageCost) -> str:
    """What holds up a stage: "loader" or "network"."""
    return "loader" if stage.waiting > _WAITING else "network"


def duration(seconds: float) -> str:
    """Seconds, minutes or hours, whichever reads best."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _shapes(costs: Costs) -> Table:
    table = Table("tensor", "shape", title="One batch", title_justify="left")
    for name, shape in costs.shapes.items():
        table.add_row(name, " x ".join(map(str, shape)))
    return table


def _parts(costs: Costs) -> Table:
    table = Table("part", "parameters", title="Network", title_justify="left")
    for name, number in (*costs.parameters.items(), ("all", sum(costs.parameters.values()))):
        table.add_row(name, f"{number / 1e6:.2f} M")
    return table


def describe_stages(costs: Costs) -> Table:
    """Rates, limits and times of the stages."""
    columns = ("stage", "epochs", "loader alone", "network alone", "together", "waiting", "limited by", "time")
    table = Table(*columns, title="Pictures per second", title_justify="left")
    for stage in costs.stages:
        rates = (f"{rate:.1f}" for rate in (stage.loader, stage.network, stage.together))
        table.add_row(
            stage.name, str(stage.epochs), *rates, f"{stage.waiting:.0%}", limit(stage), duration(stage.seconds)
        )
    return table


def _sentences(config: TrainConfig, costs: Costs) -> list[str]:
    step = costs.memory - costs.memory_before
    lines = [
        f"{costs.pictures} pictures, {costs.steps} steps an epoch, {config.stages.epochs} epochs: "
        f"{duration(costs.seconds)} on this machine, measured now.",
        f"{costs.flops / 1e9:.2f} GFLOP a picture forwards (a step takes about three times that).",
        f"Memory at most {costs.memory / 1e9:.2f} GB, of which a step adds {step / 1e9:.2f} GB.",
        f"{costs.validations} validations of about {duration(costs.validation_seconds)}, without solving for poses.",
        f"Disk: {costs.disk / 1e6:.0f} MB in {config.output}; {costs.free / 1e9:.1f} GB are free.",
    ]
    if any(limit(stage) == "loader" for stage in costs.stages):
        lines.append(_advice(config))
    if costs.disk > costs.free:
        lines.append("The disk is too small for this run.")
    return lines


def _advice(config: TrainConfig) -> str:
    cores = len(os.sched_getaffinity(0))
    if config.device != "cpu" and config.workers < cores - 1:
        more = f"give it more processes (--workers; this machine has {cores} cores)"
    else:
        more = f"all {cores} cores are in use: make augmentation cheaper (mosaic, blur, jpeg)"
    cache = "" if config.data.cache else ", or keep the pictures in memory (--data.cache)"
    return f"The network waits for pictures: {more}{cache}."
