"""`multicam train --sanity`: can the network learn eight of the pictures by heart, as it must?"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot
from pathlib import Path

import cv2
import numpy as np
import torch
from torch.nn.modules.batchnorm import _BatchNorm

from multicam.errors import DataError
from multicam.files import write_bytes
from multicam.progress import Progress, SilentProgress
from multicam.spread import spread
from train.board import draw
from train.config import LossWeights, StageConfig, StagesConfig, TrainConfig
from train.distributed import process_group
from train.fit import Learner, Run
from train.loader import ValidationSet, collate
from train.samples import PictureStore
from train.validate import Prediction, figures, predict

STEPS = 300
"""Steps at most; the check ends as soon as it is passed."""
_PICTURES = 8
_EVERY = 30
"""Steps between looks at the keypoints."""
_RATE = 1e-3
_WEIGHTS = LossWeights(likelihood=1.0, rays=10.0)
_MOMENTUM = 0.3
"""Of the running statistics: there is one batch, so they may follow it at once."""
_FOUND = 0.9
_PLACED = 0.5
_NEAR = 0.01
"""Keypoint error that passes, as a share of the input's diagonal."""


@dataclass(frozen=True)
class Verdict:
    """What became of the eight pictures.

    Attributes:
        steps: done until it passed, or until the end.
        first, last: losses of the first and the last step, by name.
        recall: share of the objects that are found; add_recall: that are placed within a tenth of their diameter.
        keypoint_px, allowed_px: median error of the keypoints, and what passes.
    """

    steps: int
    first: dict[str, float]
    last: dict[str, float]
    recall: float
    add_recall: float
    keypoint_px: float
    allowed_px: float

    @property
    def passed(self) -> bool:
        """Whether network, losses and labels do their work."""
        near = self.keypoint_px <= self.allowed_px
        return self.recall >= _FOUND and near and self.add_recall >= _PLACED

    def describe(self) -> str:
        """Losses and figures, with what must be reached in brackets."""
        losses = ", ".join(f"{name} {value:.3g} -> {self.last[name]:.3g}" for name, value in self.first.items())
        return (
            f"{_PICTURES} pictures, {self.steps} steps: {losses}.\n"
            f"Found {self.recall:.0%} [{_FOUND:.0%}], keypoints {self.keypoint_px:.1f} px off [{self.allowed_px:.1f}], "
            f"within a tenth of the diameter {self.add_recall:.0%} [{_PLACED:.0%}]."
        )

    def reason(self) -> str:
        """Where to look when it failed."""
        stuck = [name for name, value in self.first.items() if self.last[name] >= value]
        if stuck:
            return (
                f"{' and '.join(stuck)} did not fall on pictures that never change; the network, its precision or the "
                "labels are at fault, not the schedule."
            )
        if self.recall < _FOUND:
            return (
                "objects are not found. Do the white keypoints of sanity.jpg lie on the parts? If not, poses, cam_K or "
                "the unit of the models are wrong; if they do, parts of less than 16 pixels are hard: make "
                "network.input_width and input_height larger."
            )
        if self.keypoint_px > self.allowed_px:
            return (
                "objects are found but not their keypoints. Do the white keypoints of sanity.jpg lie on the parts? If "
                "not, poses or cam_K are wrong; if they jump between alike pictures, models_info.json lacks a symmetry."
            )
        return (
            "keypoints are right in the picture but the poses that follow are not: keypoints.json may lie in a line or "
            "plane, or the parts are so far away that their depth cannot be seen."
        )


def sanity_check(config: TrainConfig, progress: Progress, steps: int = STEPS) -> Verdict:
    """Trains a fresh network on eight pictures as they are, and writes them as `output/sanity.jpg`.

    Size, input, classes, precision and losses are those of the configuration; schedule and learning rate are not.

    Raises:
        DataError: unusable data.
        MulticamError: a loss that is no longer finite.
    """
    stage = StageConfig(steps, _RATE, _RATE, "truth", warp=False, oks_sigma=0.25, weights=_WEIGHTS)
    none = replace(stage, epochs=0)
    data = replace(config.data, cache=False, validation=())
    width, height = config.network.window_size
    network = replace(config.network, input_width=width, input_height=height, window_width=0, window_height=0)
    config = replace(config, data=data, network=network, stages=StagesConfig(stage, none, none), warmup_steps=20)
    with process_group(config.device) as group:
        if config.threads:
            torch.set_num_threads(config.threads)
        run = Run(config, group, SilentProgress())
        pictures = _pictures(run)
        batch = collate([pictures[i] for i in range(len(pictures))]).to(group.device)
        for module in run.detector.modules():
            if isinstance(module, _BatchNorm):
                module.momentum = _MOMENTUM
        learner = Learner(run.detector, config)
        first: dict[str, float] = {}
        for step in progress.track(range(steps), "learning eight pictures"):
            run.detector.train()
            last = run.step(learner, batch, stage, step)
            first = first or last
            if (step + 1) % _EVERY and step + 1 < steps:
                continue
            predictions = predict(run.detector.eval(), pictures, len(pictures), SilentProgress(), range(len(pictures)))
            verdict = _judge(run, step + 1, first, last, predictions)
            if verdict.passed:
                break
        _write(config.output / "sanity.jpg", [draw(p, run.objects) for p in predictions])
        return verdict


def _pictures(run: Run) -> ValidationSet:
    """Eight pictures spread over the training data, each with something to learn, as the runtime sees them."""
    records = run.dataset.store.records
    objects = {known.model.obj_id: known for known in run.objects}

    def view(chosen: list[int]) -> ValidationSet:
        store = PictureStore([records[i] for i in chosen], True, SilentProgress())
        return ValidationSet(store, objects, run.config.network, run.config.minimum_visible)

    candidates = spread(range(len(records)), 4 * _PICTURES)
    tried = view(candidates)
    useful = [i for place, i in enumerate(candidates) if not tried[place][1].ignored.all()]
    if not useful:
        raise DataError(
            f"none of {len(candidates)} pictures shows an object by more than minimum_visible "
            f"({run.config.minimum_visible:g}) of itself; there is nothing to learn."
        )
    return view([useful[i * len(useful) // _PICTURES] for i in range(min(_PICTURES, len(useful)))])


def _judge(
    run: Run, steps: int, first: dict[str, float], last: dict[str, float], predictions: list[Prediction]
) -> Verdict:
    reached, network = figures(predictions, run.objects), run.config.network
    names = [name for name in first if name != "learning_rate"]
    return Verdict(
        steps,
        {name: first[name] for name in names},
        {name: last[name] for name in names},
        reached["recall"],
        reached["add_recall"],
        reached["keypoint_px"],
        _NEAR * hypot(network.input_width, network.input_height),
    )


def _write(path: Path, pictures: list[np.ndarray]) -> None:
    """All pictures on one sheet, two rows."""
    half = (len(pictures) + 1) // 2
    pictures = pictures + [np.zeros_like(pictures[0])] * (2 * half - len(pictures))
    sheet = np.vstack([np.hstack(pictures[:half]), np.hstack(pictures[half:])])
    _, encoded = cv2.imencode(".jpg", np.ascontiguousarray(sheet[..., ::-1]))
    write_bytes(path, encoded.tobytes())
