"""What each part of the recipe is worth: the same budget, several seeds, figures on held-out renders.

    python benchmarks/training_ablation.py --recipe configs/train/instruments.yaml --output $MULTICAM_DATA/ablation

Rows build on each other: regressed keypoints; the coordinate classifier; the 3-D loss in the last stage; objects pasted
over other pictures; and, with the same networks, the predicted standard deviations in PnP (before, all keypoints count
alike). Trainings that are there are not repeated, stopped ones go on. Prints a table; the output folder holds it, too,
with every figure.
"""

from __future__ import annotations

import statistics
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch

from models.detector import Decoded, Detector, RawOutputs
from multicam.config import load_config, parse_command
from multicam.dataset.objects import load_catalogue
from multicam.evaluation.report import Cell, Column, Table
from multicam.files import write_json, write_text
from multicam.progress import RichProgress, SilentProgress
from train.checkpoint import load_views, load_weights
from train.config import StageConfig, StagesConfig, TrainConfig
from train.fit import fit
from train.loader import ValidationSet
from train.samples import PictureStore, prepare_objects, read_records
from train.validate import Prediction, figures, predict

Training = Literal["regression", "classifier", "rays", "pasted"]

_UNIFORM = 1.0
"""Pixels; with one standard deviation for all keypoints PnP weighs them alike."""


@dataclass(frozen=True)
class AblationConfig:
    """Which recipe, how much of it, and where."""

    recipe: Path = Path("configs/train/instruments.yaml")
    """The whole recipe; the rows leave parts of it out."""
    output: Path = Path("data/ablation")
    """Folder of the trainings and of the table."""
    pictures: int = 30000
    """Of each training; the stages keep their shares of it."""
    seeds: int = 3
    """Trainings of each row."""
    jobs: int = 2
    """Trainings at a time, with one thread each."""
    trainings: tuple[Training, ...] = get_args(Training)
    """Which to make; rows of others are left out."""


class Regression(Detector):
    """A detector whose keypoints are the regressed ones; the classifier is not asked."""

    def decode(self, raw: RawOutputs, count: int) -> Decoded:
        """As Detector.decode, with proxies for keypoints."""
        decoded = super().decode(raw, count)
        cells = raw.class_logits.amax(dim=2).topk(count, dim=1).indices
        index = cells[..., None, None].expand(-1, -1, *raw.proxy.shape[2:])
        return decoded._replace(keypoints=raw.proxy.gather(1, index))


def _every_stage(config: TrainConfig, change: Callable[[StageConfig], StageConfig]) -> TrainConfig:
    stages = config.stages
    return replace(config, stages=StagesConfig(*(change(stage) for stage in stages.all)))


def _without_rays(config: TrainConfig) -> TrainConfig:
    return _every_stage(config, lambda s: replace(s, weights=replace(s.weights, rays=0.0)))


def _without_pasting(config: TrainConfig) -> TrainConfig:
    return replace(config, augment=replace(config.augment, pasted=0))


def _regressed(config: TrainConfig) -> TrainConfig:
    plain = _without_pasting(_without_rays(config))
    return _every_stage(plain, lambda s: replace(s, proxy_target="truth", weights=replace(s.weights, likelihood=0.0)))


TRAININGS: dict[Training, Callable[[TrainConfig], TrainConfig]] = {
    "regression": _regressed,
    "classifier": lambda config: _without_pasting(_without_rays(config)),
    "rays": _without_pasting,
    "pasted": lambda config: config,
}
ROWS: tuple[tuple[str, Training, bool], ...] = (
    ("regressed keypoints", "regression", False),
    ("+ coordinate classifier", "classifier", False),
    ("+ 3-D loss", "rays", False),
    ("+ pasted objects", "pasted", False),
    ("+ standard deviations in PnP", "pasted", True),
)


def variant(recipe: TrainConfig, name: Training, seed: int, config: AblationConfig) -> TrainConfig:
    """The training of a row: a part of the recipe, cut down to the budget."""
    train = TRAININGS[name](recipe)
    count = len(read_records(train.data.train))
    share = config.pictures / (count * train.stages.epochs)
    if share < 1:
        train = _every_stage(train, lambda s: replace(s, epochs=max(1, round(s.epochs * share)) if s.epochs else 0))
    folder = config.output / f"{name}-{seed}"
    return replace(train, seed=seed, output=folder, resume=True, threads=1, validate_every=10**6)


def run(train: TrainConfig) -> None:
    """One training, unless it is there."""
    done = train.output / "done.json"
    if done.is_file():
        return
    state = fit(train, SilentProgress())
    write_json(done, {"epochs": state.epoch})


def judge(train: TrainConfig, regression: bool, weighted: bool) -> dict[str, float]:
    """Figures of a finished training on the whole validation split."""
    torch.set_num_threads(1)
    checkpoint = train.output / "last"
    config, _, weights = load_weights(checkpoint)
    detector = (Regression if regression else Detector)(config)
    detector.load_state_dict(weights)
    detector.eval()
    records = read_records(train.data.validation)
    catalogue = load_catalogue(train.data.models)
    objects = prepare_objects(catalogue, records, load_views(checkpoint, catalogue))
    dataset = ValidationSet(
        PictureStore(records, False, SilentProgress()), objects, train.network, train.minimum_visible
    )
    found = predict(detector, dataset, 4, SilentProgress(), range(len(dataset)))
    return figures(found if weighted else [_unweighted(one) for one in found], tuple(objects.values()))


def _unweighted(prediction: Prediction) -> Prediction:
    found = prediction.found
    return replace(prediction, found=replace(found, std=np.full_like(found.std, _UNIFORM)))


def table(rows: dict[str, list[dict[str, float]]], config: AblationConfig) -> Table:
    """Mean and standard deviation over the seeds."""
    names = {"within 0.1 d %": "add_recall", "found %": "recall", "keypoint px": "keypoint_px"}
    columns = [Column("recipe", 0)]
    cells: list[tuple[Cell, ...]] = []
    for heading in names:
        columns += [Column(heading, 1), Column("+-", 1)]
    for row, seeds in rows.items():
        cell: list[Cell] = [row]
        for key in names.values():
            values = [figures[key] * (1 if key == "keypoint_px" else 100) for figures in seeds]
            cell += [statistics.mean(values), statistics.stdev(values) if len(values) > 1 else None]
        cells.append(tuple(cell))
    note = f"{config.pictures} pictures each, {config.seeds} seeds: mean and standard deviation on held-out renders."
    return Table("What each part of the recipe is worth", tuple(columns), tuple(cells), note)


def main() -> None:
    """Trains what is missing, judges all, writes the table."""
    config = parse_command(AblationConfig, sys.argv[1:], "training_ablation.py", __doc__ or "")
    recipe = load_config(TrainConfig, config.recipe)
    trainings = {
        (name, seed): variant(recipe, name, seed, config) for seed in range(config.seeds) for name in config.trainings
    }
    with ProcessPoolExecutor(config.jobs, mp_context=get_context("spawn")) as pool:
        tasks = pool.map(run, trainings.values())
        for _ in RichProgress().track(tasks, "trainings", len(trainings)):
            pass
        rows = {
            row: list(pool.map(partial(judge, regression=name == "regression", weighted=weighted), of))
            for row, name, weighted in ROWS
            if name in config.trainings
            for of in [[trainings[name, seed] for seed in range(config.seeds)]]
        }
    result = table(rows, config)
    write_json(config.output / "ablation.json", rows)
    write_text(config.output / "ablation.txt", result.to_text())
    print(result.to_text())


if __name__ == "__main__":
    main()
