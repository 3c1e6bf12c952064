"""Pictures per second of our training step against a plain YOLOX of the same size, step by step in turns.

    python benchmarks/training_throughput.py --train configs/train/instruments.yaml

Ours: the last stage with all six losses, the coordinate classifier, gradient clipping, the configuration's optimiser
and the moving average. YOLOX: `plain_yolox.py` with its losses, SGD with momentum, and the same moving average. Both
have plain convolutions and all strides, whatever the configuration asks for, and get the same batches,
loaded beforehand, in channels_last and with the same arithmetic. The ratio is the median over pairs of neighbouring
steps, so that other work on the machine hits both; that of the CPU time of the process hardly feels such work. Then the
loader: what it gives, and whether the step waits for it.
"""

from __future__ import annotations

import copy
import sys
import time
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
import torch
from plain_yolox import PlainYolox, loss
from rich.console import Console
from rich.table import Table
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from models.config import Size
from models.detector import count_parameters
from multicam.config import load_config, parse_command
from multicam.progress import RichProgress, SilentProgress
from train.config import TrainConfig
from train.distributed import process_group
from train.dry_run import describe_stages
from train.fit import Learner, Run
from train.loader import Batch, training_loader
from train.measure import measure
from train.optimizer import MovingAverage


@dataclass(frozen=True)
class ThroughputConfig:
    """Options of the benchmark."""

    train: Path
    """Training configuration: data, input, batch size, losses."""
    sizes: tuple[Size, ...] = ("nano", "tiny", "s")
    """Networks to compare."""
    pairs: int = 12
    """Pairs of steps of each; two more go first and are not counted."""
    threads: int = 2
    """Threads of PyTorch."""
    loader: bool = True
    """Also the stages of the configuration with their loader."""


class PlainRun:
    """One training of the plain network."""

    def __init__(self, run: Run) -> None:
        torch.manual_seed(0)
        self.network = PlainYolox(run.model_config).to(run.group.device, memory_format=torch.channels_last)
        self.average = MovingAverage(self.network, run.config.ema_decay)
        self.optimizer = torch.optim.SGD(self.network.parameters(), 1e-3, 0.9, nesterov=True, weight_decay=5e-4)
        self.half = run.config.precision == "bf16"

    def step(self, batch: Batch) -> float:
        """As YOLOX's trainer does it."""
        images = batch.images.float().contiguous(memory_format=torch.channels_last)
        with torch.autocast(images.device.type, torch.bfloat16, enabled=self.half):
            outputs = self.network(images)
        value = loss(*outputs, batch)
        self.optimizer.zero_grad(set_to_none=True)
        value.backward()
        self.optimizer.step()
        self.average.update()
        return value.item()


def compare(config: TrainConfig, pairs: int) -> list[str]:
    """One row of the table: parameters and GFLOP of both, pictures per second of both, ratio and its quartiles."""
    with process_group(config.device) as group:
        run = Run(config, group, SilentProgress())
        learner, plain, stage = Learner(run.detector, config), PlainRun(run), config.stages.third
        run.detector.train()
        run.sampler.set_epoch(0, 0, replace(stage, warp=True))
        batches = list(islice(training_loader(run.dataset, run.sampler, 0), 4))
        ours, theirs = [], []
        for i in range(pairs + 2):
            batch = batches[i % len(batches)].to(group.device)
            actions = [(ours, lambda b: run.step(learner, b, stage, 0)), (theirs, plain.step)]
            for times, action in actions if i % 2 else actions[::-1]:
                started = time.perf_counter(), time.process_time()
                action(batch)
                times.append((time.perf_counter() - started[0], time.process_time() - started[1]))
        own, plain_times = np.array(ours[2:]), np.array(theirs[2:])
        (wall, cpu), size = np.median(plain_times / own, axis=0), config.batch_size
        low, high = np.quantile(plain_times[:, 0] / own[:, 0], (0.25, 0.75))
        return [
            config.network.size,
            config.precision,
            f"{count_parameters(run.detector) / 1e6:.2f} / {count_parameters(plain.network) / 1e6:.2f}",
            f"{_gflop(run.detector, batches[0]):.2f} / {_gflop(plain.network, batches[0]):.2f}",
            f"{size / np.median(own[:, 0]):.1f}",
            f"{size / np.median(plain_times[:, 0]):.1f}",
            f"{wall:.2f} ({low:.2f} to {high:.2f})",
            f"{cpu:.2f}",
        ]


def _gflop(network: nn.Module, batch: Batch) -> float:
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        copy.deepcopy(network).eval()(batch.images[:1].float())
    return counter.get_total_flops() / 1e9


def main() -> None:
    """Prints both tables."""
    options = parse_command(ThroughputConfig, sys.argv[1:], "training_throughput.py", __doc__ or "")
    base = load_config(TrainConfig, options.train)
    torch.set_num_threads(options.threads)
    table = Table("size", "arithmetic", "M parameters", "GFLOP", "ours /s", "YOLOX /s", "ratio (quartiles)", "CPU time")
    for size in options.sizes:
        for precision in ("fp32", "bf16"):
            # Plain convolutions and all strides, as the plain YOLOX has them.
            network = replace(base.network, size=size, strides=(8, 16, 32), depthwise=False)
            config = replace(base, network=network, precision=precision, threads=options.threads)
            table.add_row(*compare(config, options.pairs))
    console = Console()
    console.print(table)
    if options.loader:
        costs = measure(replace(base, threads=options.threads), RichProgress())
        console.print(describe_stages(costs))


if __name__ == "__main__":
    main()
