"""What a run costs, measured on a few of its own steps that nothing is kept of."""

from __future__ import annotations

import resource
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, islice
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode

from models.detector import count_parameters
from multicam.progress import Progress, SilentProgress
from train.board import PICTURES
from train.config import StageConfig, TrainConfig
from train.distributed import process_group
from train.fit import LOG_EVERY, Learner, Run
from train.loader import Batch, training_loader
from train.validate import predict

_SECONDS = 5.0
"""How long each rate is measured, at least."""
_LEAST = 3
"""Steps of each rate, at least."""
_SCALARS = 500
"""Bytes of TensorBoard per point of all losses."""
_PICTURE_BYTES = 1.2
"""Bytes per pixel of a validation picture in TensorBoard, as PNG."""


@dataclass(frozen=True)
class StageCost:
    """One stage of the schedule.

    Attributes:
        loader, network: pictures per second of each alone; together: of the real loop.
        waiting: share of the loop in which the network has no batch yet.
        seconds: of the whole stage, without validation.
    """

    name: str
    epochs: int
    loader: float
    network: float
    together: float
    waiting: float
    seconds: float


@dataclass(frozen=True)
class Costs:
    """A run, before it is begun.

    Attributes:
        shapes: what flows through the network, by name, for one batch.
        parameters: numbers of trained scalars by part of the network.
        flops: floating point operations of one picture forwards.
        memory, memory_before: bytes of the process at its peak, and before the first step (pictures, libraries); of the
            GPU where there is one.
        validations, validation_seconds: how many, and how long each takes, without poses.
        disk, free: bytes that the run will take, and that the disk has.
    """

    pictures: int
    steps: int
    shapes: dict[str, tuple[int, ...]]
    parameters: dict[str, int]
    flops: int
    memory: int
    memory_before: int
    stages: tuple[StageCost, ...]
    validations: int
    validation_seconds: float
    disk: int
    free: int

    @property
    def seconds(self) -> float:
        """Of the whole run."""
        return sum(stage.seconds for stage in self.stages) + self.validations * self.validation_seconds


def measure(config: TrainConfig, progress: Progress) -> Costs:
    """Builds the run, does a few steps of each stage, and forgets them; writes nothing.

    Raises:
        MulticamError: whatever would stop the run itself.
    """
    with process_group(config.device) as group:
        if config.threads:
            torch.set_num_threads(config.threads)
        run = Run(config, group, progress)
        learner = Learner(run.detector, config)
        names = [name for name in ("first", "second", "third") if getattr(config.stages, name).epochs]
        batch = next(_batches(run, getattr(config.stages, names[0])))
        flops = _flops(run.detector, batch)
        before = _memory(group.device)
        shapes = _shapes(run, learner, batch, getattr(config.stages, names[0]))
        costs = [_stage(run, learner, name) for name in progress.track(names, "measuring stages")]
        validations, each = _validation(run)
        return Costs(
            len(run.dataset),
            len(run.sampler),
            shapes,
            {name: count_parameters(part) for name, part in run.detector.named_children()},
            flops,
            _memory(group.device),
            before,
            tuple(costs),
            validations,
            each,
            _disk(run, validations),
            shutil.disk_usage(_nearest_folder(config.output)).free,
        )


def _stage(run: Run, learner: nn.Module, name: str) -> StageCost:
    stage: StageConfig = getattr(run.config.stages, name)
    size = run.config.batch_size
    batches = _batches(run, stage)
    # Batches loaded ahead cost nothing when they are taken; they go first.
    ahead = list(islice(batches, 1 + 2 * run.config.workers))
    loader = _rate(lambda: next(batches))
    run.detector.train()
    network = _rate(lambda: run.step(learner, ahead[0], stage, 0))
    waited, started, done = 0.0, time.monotonic(), 0
    while done < _LEAST or time.monotonic() - started < _SECONDS:
        asked = time.monotonic()
        batch = next(batches).to(run.group.device)
        waited += time.monotonic() - asked
        run.step(learner, batch, stage, 0)
        done += 1
    each = (time.monotonic() - started) / done
    seconds = stage.epochs * len(run.sampler) * each
    share = waited / (done * each)
    return StageCost(name, stage.epochs, loader * size, network * size, size / each, share, seconds)


def _rate(action: Any) -> float:
    """How often a second an action can be done."""
    started, done = time.monotonic(), 0
    while done < _LEAST or time.monotonic() - started < _SECONDS:
        action()
        done += 1
    return done / (time.monotonic() - started)


def _batches(run: Run, stage: StageConfig) -> Iterator[Batch]:
    """Epoch after epoch of a stage, as the run loads them."""
    for epoch in count():
        run.sampler.set_epoch(epoch, 0, stage)
        yield from training_loader(run.dataset, run.sampler, run.config.workers)


def _flops(detector: nn.Module, batch: Batch) -> int:
    detector.eval()
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        detector(batch.images[:1].to(next(detector.parameters()).device).float())
    return counter.get_total_flops()


def _shapes(run: Run, learner: nn.Module, batch: Batch, stage: StageConfig) -> dict[str, tuple[int, ...]]:
    """Shapes of all that one step passes between the parts of the network."""
    shapes: dict[str, tuple[int, ...]] = {"images": tuple(batch.images.shape)}

    def note(part: str):
        def hook(module: nn.Module, inputs: Any, outputs: Any) -> None:
            fields = getattr(outputs, "_fields", None) or [str(i) for i in range(len(outputs))]
            named = zip(fields, outputs, strict=True)
            shapes.update({f"{part} {name}": tuple(value.shape) for name, value in named if isinstance(value, Tensor)})

        return hook

    detector = run.detector
    parts = {"backbone": detector.backbone, "neck": detector.neck, "cells": detector, "classifier": detector.classifier}
    handles = [module.register_forward_hook(note(part)) for part, module in parts.items()]
    detector.train()
    run.step(learner, batch.to(run.group.device), stage, 0)
    for handle in handles:
        handle.remove()
    return shapes


def _memory(device: torch.device) -> int:
    """Bytes at the highest so far."""
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated(device)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _validation(run: Run) -> tuple[int, float]:
    """How many validations there will be, and seconds of each."""
    config, available = run.config, len(run.validation)
    if not available:
        return 0, 0.0
    each = min(config.data.validation_limit, available)
    tried = list(range(min(config.batch_size, each)))
    started = time.monotonic()
    predict(run.average.model, run.validation, config.batch_size, SilentProgress(), tried)
    epochs = range(1, config.stages.epochs + 1)
    due = sum(e % config.validate_every == 0 or e == config.stages.epochs for e in epochs)
    return due, (time.monotonic() - started) / len(tried) * each


def _disk(run: Run, validations: int) -> int:
    """Bytes of last, best and a checkpoint being written, and of TensorBoard."""
    state = sum(t.numel() * t.element_size() for t in run.detector.state_dict().values())
    moments = 2 * sum(p.numel() * p.element_size() for p in run.detector.parameters())
    network = run.config.network
    pictures = PICTURES * network.input_width * network.input_height * _PICTURE_BYTES
    points = run.config.stages.epochs * len(run.sampler) // LOG_EVERY
    return int(3 * (2 * state + moments) + points * _SCALARS + validations * pictures)


def _nearest_folder(path: Path) -> Path:
    """The path, or the nearest folder above it that exists."""
    return next(p for p in (path.absolute(), *path.absolute().parents) if p.is_dir())
