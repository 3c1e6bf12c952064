"""The training loop: epochs of steps, validation, checkpoints, resuming."""

from __future__ import annotations

import logging
import time
import warnings
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from models.detector import Detector, count_parameters
from multicam.config import save_config
from multicam.dataset.objects import Catalogue, load_catalogue
from multicam.errors import DataError, MulticamError
from multicam.progress import Progress, SilentProgress
from multicam.types import FloatArray
from train.board import Board
from train.checkpoint import RunState, find_checkpoint, load_views, restore, save_checkpoint, take_over
from train.config import WINDOWS, StageConfig, TrainConfig
from train.criterion import criterion, total
from train.distributed import Group, StopSignal, process_group
from train.exported import take_exported
from train.folded import NetworkFile, is_network_file
from train.loader import Batch, EpochSampler, TrainingSet, ValidationSet, collate, training_loader
from train.optimizer import MovingAverage, build_optimizer, learning_rate
from train.published import take_published
from train.samples import PictureStore, TrainedObject, prepare_objects, read_records
from train.shared_norm import share_norms
from train.validate import figures, is_better, predict

LOG_EVERY = 20
"""Steps between points in TensorBoard."""

_CALIBRATION = 16
"""Pictures from which the normalisations of a network file get their statistics."""

log = logging.getLogger(__name__)


def fit(config: TrainConfig, progress: Progress | None = None) -> RunState:
    """Trains, or continues from `output/last`; the run's folder holds config.yaml, last/, best/ and tensorboard/.

    Raises:
        MulticamError: unusable data, a run that is there already, a loss that is no longer finite.
        KeyboardInterrupt: the run was told to stop (Ctrl-C, SIGTERM); it has saved itself.
    """
    last = find_checkpoint(config.output / "last")
    if last and not config.resume:
        raise DataError(f"{last} exists; add --resume to continue that run, or choose another output folder.")
    with process_group(config.device) as group, StopSignal().watching() as stop:
        if config.threads:
            torch.set_num_threads(config.threads)
        run = Run(config, group, progress if progress and group.leads else SilentProgress(), last or config.initial)
        if last:
            run.resume(last)
        elif config.initial:
            run.begin_with(config.initial)
        return run.train(stop)


class Learner(nn.Module):
    """Network and losses in one module, so that every parameter is used inside the wrapped forward."""

    def __init__(self, detector: Detector, config: TrainConfig) -> None:
        super().__init__()
        self.detector, self.config = detector, config

    def forward(self, batch: Batch, stage: StageConfig) -> dict[str, Tensor]:
        """Unweighted losses of a batch."""
        images = batch.images.float().contiguous(memory_format=torch.channels_last)
        with torch.autocast(images.device.type, torch.bfloat16, enabled=self.config.precision == "bf16"):
            raw = self.detector(images)
        return criterion(self.detector, raw, batch, self.config, stage)


class Run:
    """All that changes during a run, which learns by the canonical views of the checkpoint it begins with, if any."""

    def __init__(self, config: TrainConfig, group: Group, progress: Progress, checkpoint: Path | None = None) -> None:
        self.config, self.group, self.progress = config, group, progress
        self.catalogue = load_catalogue(config.data.models)
        self.model_config = config.network.model_config(self.catalogue)
        torch.manual_seed(config.seed)
        self.detector = Detector(self.model_config).to(group.device, memory_format=torch.channels_last)
        self.average = MovingAverage(self.detector, config.ema_decay)
        if group.processes > 1 and config.shared_norms:
            share_norms(self.detector)
        self.parameters = list(self.detector.parameters())
        half = config.precision == "bf16"
        self.optimizer = build_optimizer(self.detector, config.optimizer, config.weight_decay, half)
        learnt = load_views(checkpoint, self.catalogue) if checkpoint and not is_network_file(checkpoint) else {}
        self.dataset, self.validation, self.objects = _datasets(config, self.catalogue, learnt, progress)
        self.sampler = EpochSampler(len(self.dataset), config.batch_size, config.seed, group.rank, group.processes)
        self.state = RunState(0, 0, config.network.input_width, config.network.input_height)

    def begin_with(self, path: Path) -> None:
        """Takes over weights: of a checkpoint, of a network that was exported, or of a published YOLOX."""
        if is_network_file(path):
            file = NetworkFile.read(path)
            take = take_exported if file.metadata else take_published
            fresh = take(file, self.detector, self._first_pictures())
        else:
            fresh = take_over(path, self.detector)
        self.average.model.load_state_dict(self.detector.state_dict())
        if self.group.leads:
            log.info("weights of %s; new are: %s", path, ", ".join(fresh) or "none")

    def _first_pictures(self) -> Tensor:
        stage, _ = self.config.stages.at(0)
        indices = _spread(len(self.dataset), _CALIBRATION)
        return collate([self.dataset[0, index, stage] for index in indices]).images.to(self.group.device)

    def resume(self, folder: Path) -> None:
        """Continues from a checkpoint."""
        self.state = restore(folder, self.detector, self.average, self.optimizer)
        log.info("continuing at epoch %d, step %d", self.state.epoch, self.state.step)

    def train(self, stop: StopSignal) -> RunState:
        """Runs all epochs that remain."""
        config = self.config
        if self.group.leads:
            save_config(config, config.output / "config.yaml")
            log.info(
                "%s network, %.2f M parameters; %d pictures%s, %d steps an epoch, %d epochs",
                config.network.size,
                count_parameters(self.detector) / 1e6,
                len(self.dataset),
                f" of {WINDOWS} windows" if config.network.windows else "",
                len(self.sampler),
                config.stages.epochs,
            )
        step = self.state.epoch * len(self.sampler) + self.state.step
        self.board = Board(config.output / "tensorboard", step) if self.group.leads else None
        learner: nn.Module = Learner(self.detector, config)
        if self.group.processes > 1:
            with warnings.catch_warnings():
                # The option has another name from PyTorch 2.14 on; this one is known to all.
                warnings.simplefilter("ignore", FutureWarning)
                learner = DistributedDataParallel(learner, broadcast_buffers=False)
        for epoch in range(self.state.epoch, config.stages.epochs):
            self._epoch(learner, epoch, stop)
        if self.board:
            self.board.close()
        return self.state

    def _epoch(self, learner: nn.Module, epoch: int, stop: StopSignal) -> None:
        stage, _ = self.config.stages.at(epoch)
        if epoch and self.state.step == 0 and self.config.stages.at(epoch - 1)[0].scale != stage.scale:
            # Figures on pictures of another size are no match.
            self.state = replace(self.state, best={})
        self.sampler.set_epoch(epoch, self.state.step, stage)
        self.detector.train()
        loader = training_loader(self.dataset, self.sampler, self.config.workers)
        started, first = time.monotonic(), self.state.step
        batches = self.progress.track(loader, f"epoch {epoch + 1}", total=len(self.sampler) - first)
        sums: dict[str, float] = defaultdict(float)
        for step, batch in enumerate(batches, start=first):
            number = epoch * len(self.sampler) + step
            losses = self.step(learner, batch.to(self.group.device), stage, number)
            for name, value in losses.items():
                sums[name] += value
            if self.board and number % LOG_EVERY == 0:
                self.board.scalars("train", losses, number)
            self._moved(epoch, step + 1)
            if self.group.any(stop.given):
                self._save("last")
                log.info("stopped at epoch %d, step %d; --resume continues there", epoch + 1, step + 1)
                raise KeyboardInterrupt
        count = len(self.sampler) - first
        rate = count * self.config.batch_size * self.group.processes / (time.monotonic() - started)
        self._moved(epoch + 1, 0)
        self._finish_epoch(epoch, rate, {name: value / max(count, 1) for name, value in sums.items()})

    def step(self, learner: nn.Module, batch: Batch, stage: StageConfig, number: int) -> dict[str, float]:
        """One step of the optimiser; the unweighted losses, their weighted sum and the learning rate.

        Raises:
            MulticamError: the loss is no longer finite.
        """
        rate = learning_rate(self.config.stages, len(self.sampler), self.config.warmup_steps, number)
        for parameters in self.optimizer.param_groups:
            parameters["lr"] = rate
        tensors = learner(batch, stage)
        loss = total(tensors, stage)
        losses = dict(zip(tensors, torch.stack([value.detach() for value in tensors.values()]).tolist(), strict=True))
        if not torch.isfinite(loss):
            values = ", ".join(f"{name} {value:.3g}" for name, value in losses.items())
            raise MulticamError(
                f"the loss is no longer finite at step {number} ({values}); halve the learning rates "
                "or set precision to fp32, and resume from the last checkpoint."
            )
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.parameters, self.config.gradient_clip)
        self.optimizer.step()
        self.average.update()
        return losses | {"total": loss.item(), "learning_rate": rate}

    def _finish_epoch(self, epoch: int, pictures_per_second: float, losses: dict[str, float]) -> None:
        config = self.config
        due = (epoch + 1) % config.validate_every == 0 or epoch + 1 == config.stages.epochs
        if self.group.leads:
            text = " ".join(f"{name} {value:.3f}" for name, value in losses.items() if name != "learning_rate")
            log.info("epoch %d: %.1f pictures/s, means: %s", epoch + 1, pictures_per_second, text)
            improved = due and len(self.validation) > 0 and self._validate(epoch)
            self._save("last")
            if improved or not len(self.validation):
                self._save("best")
        self.group.wait()

    def _validate(self, epoch: int) -> bool:
        """Measures the averaged weights; whether they are the best so far."""
        network = self.config.network.scaled(self.config.stages.at(epoch)[0].scale)
        self.validation.size = network.input_width, network.input_height
        indices = _spread(len(self.validation), self.config.data.validation_limit)
        average = self.average.model
        predictions = predict(average, self.validation, self.config.batch_size, self.progress, indices)
        metrics = figures(predictions, self.objects)
        better = is_better(metrics, self.state.best)
        best = metrics if better else self.state.best
        self.state = replace(self.state, metrics=metrics, best=best)
        log.info("epoch %d: %s", epoch + 1, " ".join(f"{k} {v:.3f}" for k, v in metrics.items()))
        if self.board:
            step = (epoch + 1) * len(self.sampler)
            self.board.scalars("validation", metrics, step)
            self.board.pictures(predictions, self.objects, step)
        return better

    def _moved(self, epoch: int, step: int) -> None:
        self.state = replace(self.state, epoch=epoch, step=step, ema_updates=self.average.updates)

    def _save(self, name: str) -> None:
        if self.group.leads:
            save_checkpoint(
                self.config.output / name,
                self.detector,
                self.average,
                self.optimizer,
                self.model_config,
                self.catalogue,
                {one.model.obj_id: view for one in self.objects if (view := one.canonical.view) is not None},
                self.state,
            )


def _datasets(
    config: TrainConfig, catalogue: Catalogue, learnt: Mapping[int, FloatArray], progress: Progress
) -> tuple[TrainingSet, ValidationSet, Sequence[TrainedObject]]:
    records = read_records(config.data.train)
    held_out = read_records(config.data.validation)
    objects = prepare_objects(catalogue, [*records, *held_out], learnt)
    network, minimum = config.network, config.minimum_visible
    store = PictureStore(records, config.data.cache, progress, with_instances=config.needs_masks)
    train = TrainingSet(store, objects, network, config.augment, minimum, config.seed)
    validation = ValidationSet(PictureStore(held_out, False, progress), objects, network, minimum)
    return train, validation, tuple(objects.values())


def _spread(count: int, limit: int) -> list[int]:
    """At most `limit` indices, evenly over `count`."""
    return [i * count // limit for i in range(limit)] if count > limit else list(range(count))
