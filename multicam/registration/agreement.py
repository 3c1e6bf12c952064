"""Learns the noise of estimates from how well they agree over many groups of views; ground truth is never needed.

Variance components: register the groups with the noise known so far, compare every estimate with where the others put
it, take squares over redundancies, repeat (docs/registration.md, "Noise from agreement").
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import root_scalar

from multicam.bundle.robust import Student
from multicam.dataset.objects import Catalogue
from multicam.matching.learned import BLOCKS, ClassNoise, NoiseModel
from multicam.progress import Progress, SilentProgress
from multicam.registration.config import RegistrationConfig
from multicam.registration.group import Group
from multicam.registration.halves import disagreement, variance_ratio
from multicam.registration.register import solve
from multicam.registration.residuals import Residuals
from multicam.types import FloatArray, View

CLASS_PRIOR, COMMON_PRIOR = 8.0, 60.0
"""Numbers that the common noise counts for against those of one class, and the stated noise against the common one."""

TOO_FAR_STD = 0.02
"""How far off, as a share of the distance, depths of a class are expected to be on average."""

APART = 3
"""Views of a group that kinship is learnt from: among many, every view has like ones."""

LARGEST_LOG_SCALE = 10.0
"""Bound of the search for a scale."""

Mapper = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
"""An ordered map, in this process or over several."""


@dataclass(frozen=True)
class LearningConfig:
    """How the noise of estimates is learnt from their agreement."""

    rounds: int = 6
    """Rounds of registering and revising; 0 takes all estimates at their word."""
    groups: int = 200
    """Groups to learn from, spread over all."""

    def __post_init__(self) -> None:
        if self.rounds < 0 or self.groups < 1:
            raise ValueError(f"learning needs 0 or more rounds and 1 or more groups; got {self.rounds}, {self.groups}")


def learn_noise(
    groups: Sequence[tuple[View, ...]],
    catalogue: Catalogue,
    config: RegistrationConfig,
    learning: LearningConfig,
    mapper: Mapper = map,
    progress: Progress | None = None,
) -> NoiseModel:
    """The noise of the estimates of all groups; the model that changes nothing after 0 rounds.

    Args:
        groups: views taken at one time each.
        mapper: spreads the groups over processes; the answer is the same for any number.
    """
    step = -(-len(groups) // learning.groups)
    chosen, progress = groups[::step], progress or SilentProgress()
    student = Student(config.consensus.likelihood.tail, dimension=6)
    model = NoiseModel()

    def agreement(views: Sequence[tuple[View, ...]], text: str) -> tuple[list[Residuals], FloatArray]:
        found = mapper(partial(agreement_of_group, catalogue=catalogue, config=config, noise=model), views)
        parts = [part for parts in progress.track(found, text, total=len(views)) for part in parts]
        return [part[0] for part in parts], np.concatenate([np.zeros(0), *(part[1] for part in parts)])

    for number in range(1, learning.rounds + 1):
        residuals, distances = agreement(chosen, f"learning the noise, {number} of {learning.rounds}")
        if not residuals:
            return model
        # Estimates that the present noise rules out are missing among the residuals; the halves tell all the same.
        model = update(Residuals.joined(residuals), model, student).widened(max(1.0, variance_ratio(distances)))
    if learning.rounds:
        residuals, _ = agreement([_apart(views) for views in chosen], "comparing like and unlike views")
        model = replace(model, kinship=kinship_of(Residuals.joined(residuals), model, student) if residuals else 1.0)
    return model


def agreement_of_group(
    views: tuple[View, ...], catalogue: Catalogue, config: RegistrationConfig, noise: NoiseModel
) -> list[tuple[Residuals, FloatArray]]:
    """Registers a group; of each of its components the residuals, and the distances between halves of its objects."""
    group = Group.of(views, catalogue, config, noise)
    return [(Residuals.of(group, found, noise), disagreement(group, found)) for found in solve(group)[0]]


def update(residuals: Residuals, noise: NoiseModel, student: Student) -> NoiseModel:
    """One revision of all factors: weighted squares of residuals over their redundancy.

    With weights u of the Student distribution and P the variance of an estimate's place, a squared factor is the sum of
    u deviation^2 over the sum of count - u P, with 8 numbers in favour of what all classes say (Foerstner 1979).
    """
    squared, place, counts = residuals.relative_to(noise)
    weight = student.weight(np.sum(squared + place, axis=1))[:, None]
    before = noise.factors(residuals.obj_id)[:, [block.start for block in BLOCKS]]
    squares, redundancy = weight * squared * before**2, np.maximum(counts - weight * place, 0)
    common = (COMMON_PRIOR + squares.sum(axis=0)) / (COMMON_PRIOR + redundancy.sum(axis=0))
    classes: dict[int, ClassNoise] = {}
    for obj_id in np.unique(residuals.obj_id).tolist():
        own = residuals.obj_id == obj_id
        variance = (CLASS_PRIOR * common + squares[own].sum(axis=0)) / (CLASS_PRIOR + redundancy[own].sum(axis=0))
        relative = residuals.deviation[own, 5] / residuals.distance[own]
        depth_variance = residuals.expected[own, 5, 5] * before[own, 2] ** 2
        precision = weight[own, 0] * residuals.distance[own] ** 2 / depth_variance
        shift = float(np.sum(precision * relative) / (np.sum(precision) + TOO_FAR_STD**-2))
        classes[obj_id] = ClassNoise(*np.sqrt(variance).tolist(), too_far=noise.of(obj_id).too_far + shift)
    return NoiseModel(classes, ClassNoise(*np.sqrt(common).tolist()))


def kinship_of(residuals: Residuals, noise: NoiseModel, student: Student) -> float:
    """How many times larger the variances of estimates without a like view are than those of all; at least 1."""
    squared, place, counts = (part.sum(axis=1) for part in residuals.relative_to(noise))
    unlike = residuals.unlike
    alone = scale_of(squared[unlike], place[unlike], counts[unlike], student)
    return max(1.0, alone / scale_of(squared, place, counts, student))


def scale_of(squared: FloatArray, place: FloatArray, counts: FloatArray, student: Student) -> float:
    """How many times larger the variances of edges (e,) are than expected; see Residuals.relative_to."""

    def excess(log_scale: float) -> float:
        relative = squared / np.exp(log_scale) + place
        return float(np.sum(student.weight(relative) * relative - counts) + COMMON_PRIOR * np.expm1(-log_scale))

    return float(np.exp(float(root_scalar(excess, bracket=(-LARGEST_LOG_SCALE, LARGEST_LOG_SCALE)).root)))


def _apart(views: tuple[View, ...]) -> tuple[View, ...]:
    """A few views, spread over the group."""
    return tuple(views[i] for i in np.linspace(0, len(views) - 1, min(APART, len(views))).round().astype(int))
