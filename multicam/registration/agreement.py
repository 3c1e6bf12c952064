"""Learns the noise of estimates from how well they agree over many groups of views; ground truth is never needed.

Expectation-maximisation: register the groups with the noise known so far, compare every estimate with where the others
put it, take the mean square of what remains, repeat (docs/registration.md, "Noise from agreement").
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from multicam.bundle.problem import Problem, State
from multicam.bundle.robust import Student
from multicam.dataset.objects import Catalogue
from multicam.geometry import se3
from multicam.matching.arrays import BoolArray, IntArray
from multicam.matching.learned import BLOCKS, ClassNoise, NoiseModel, centre_in_camera, viewing_axes
from multicam.matching.linear import congruent, inverse
from multicam.progress import Progress, SilentProgress
from multicam.registration.config import RegistrationConfig
from multicam.registration.edges import pose_factor
from multicam.registration.group import Group
from multicam.registration.refinement import Refinement
from multicam.registration.register import solve
from multicam.types import FloatArray, View

ALIKE = np.cos(np.radians(30))
"""Cosine between directions of view, seen from the object, above which errors of one network count as related."""

CLASS_PRIOR, COMMON_PRIOR = 20.0, 60.0
"""Numbers that the common noise counts for against those of one class, and the stated noise against the common one."""

TOO_FAR_STD = 0.02
"""How far off, as a share of the distance, depths of a class are expected to be on average."""

FREE = 1.0
"""Variance of an attitude, rad^2, from which a direction is free (a turn about a symmetry axis) and tells nothing."""

SCALE_ROUNDS = 20
"""Fixed-point rounds for the kinship, whose convergence is linear."""

LARGEST_KINSHIP = 4.0
"""Unlike views that disagree more than this show that the factors are not found yet, not how related like views are."""

Mapper = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
"""An ordered map, in this process or over several."""


@dataclass(frozen=True)
class LearningConfig:
    """How the noise of estimates is learnt from their agreement."""

    rounds: int = 5
    """Rounds of expectation-maximisation; 0 takes all estimates at their word."""
    groups: int = 200
    """Groups to learn from, spread over all."""

    def __post_init__(self) -> None:
        if self.rounds < 0 or self.groups < 1:
            raise ValueError(f"learning needs 0 or more rounds and 1 or more groups; got {self.rounds}, {self.groups}")


@dataclass(frozen=True, eq=False)
class Residuals:
    """Estimates against the places where all of their group put them; coordinates of `viewing_axes`.

    Attributes:
        obj_id: (e,).
        deviation: (e, 6) estimate less place.
        expected: (e, 6, 6) covariance of an estimate with all factors 1.
        place: (e, 6, 6) covariance of its place.
        factors: (e, 6) the factors used.
        distance: (e,) of the object, metres.
        unlike: (e,) whether the object was seen from no like direction in the group.
    """

    obj_id: IntArray
    deviation: FloatArray
    expected: FloatArray
    place: FloatArray
    factors: FloatArray
    distance: FloatArray
    unlike: BoolArray

    @classmethod
    def joined(cls, parts: Sequence[Residuals]) -> Residuals:
        """All in one."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__))

    def whitened(self) -> tuple[FloatArray, FloatArray]:
        """Squared deviation and share of the place's variance, (e, 3) each: per block, with all factors 1."""
        squared, share = np.zeros((len(self.obj_id), 3)), np.zeros((len(self.obj_id), 3))
        for n, block in enumerate(BLOCKS):
            information = inverse(self.expected[:, block, block])
            squared[:, n] = np.einsum("ei,eij,ej->e", self.deviation[:, block], information, self.deviation[:, block])
            share[:, n] = np.einsum("eij,eji->e", information, self.place[:, block, block])
        return squared, share

    def counts(self) -> FloatArray:
        """(e, 3) how many directions of each block are not free."""
        free = np.sum(np.linalg.eigvalsh(self.expected[:, :3, :3]) > FREE, axis=-1)
        return np.stack((3.0 - free, np.full(len(free), 2.0), np.ones(len(free))), axis=1)


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
    for number in range(1, learning.rounds + 1):
        # Kinship only makes registration more cautious; it must not keep groups from being learnt from.
        known = replace(model, kinship=1.0)
        found = mapper(partial(residuals_of_group, catalogue=catalogue, config=config, noise=known), chosen)
        tracked = progress.track(found, f"learning the noise, {number} of {learning.rounds}", total=len(chosen))
        parts = [part for parts in tracked for part in parts]
        if not parts:
            return model
        model = update(Residuals.joined(parts), known, student)
    return model


def residuals_of_group(
    views: tuple[View, ...], catalogue: Catalogue, config: RegistrationConfig, noise: NoiseModel
) -> list[Residuals]:
    """Registers a group; the residuals of each of its components."""
    group = Group.of(views, catalogue, config, noise)
    return [_residuals(group, refinement, noise) for refinement in solve(group)[0]]


def update(residuals: Residuals, noise: NoiseModel, student: Student) -> NoiseModel:
    """One maximisation step.

    With weights u of the Student distribution, a factor's square is the mean of u deviation^2 + variance of the place,
    in units of the expected variance, over all estimates of the class and 20 numbers that say what all classes say.
    """
    squared, share = residuals.whitened()
    counts, factors = residuals.counts(), residuals.factors[:, [0, 3, 5]]
    weight = student.weight(np.sum(squared / factors**2, axis=1))[:, None]
    moments = weight * squared + np.minimum(share, counts)
    common = (COMMON_PRIOR + moments.sum(axis=0)) / (COMMON_PRIOR + counts.sum(axis=0))
    classes: dict[int, ClassNoise] = {}
    for obj_id in np.unique(residuals.obj_id).tolist():
        own = residuals.obj_id == obj_id
        variance = (CLASS_PRIOR * common + moments[own].sum(axis=0)) / (CLASS_PRIOR + counts[own].sum(axis=0))
        relative = residuals.deviation[own, 5] / residuals.distance[own]
        precision = (
            weight[own, 0] * residuals.distance[own] ** 2 / (residuals.expected[own, 5, 5] * factors[own, 2] ** 2)
        )
        shift = np.sum(precision * relative) / (np.sum(precision) + TOO_FAR_STD**-2)
        attitude, lateral, depth = np.sqrt(variance).tolist()
        classes[obj_id] = ClassNoise(attitude, lateral, depth, noise.of(obj_id).too_far + float(shift))
    attitude, lateral, depth = np.sqrt(common).tolist()
    model = NoiseModel(classes, ClassNoise(attitude, lateral, depth))
    variances = model.factors(residuals.obj_id)[:, [0, 3, 5]] ** 2
    squared, share = np.sum(squared / variances, axis=1), np.sum(np.minimum(share / variances, counts), axis=1)
    unlike = residuals.unlike
    return replace(model, kinship=_kinship(squared[unlike], share[unlike], counts[unlike], student))


def _kinship(squared: FloatArray, share: FloatArray, counts: FloatArray, student: Student) -> float:
    """How many times larger than stated the variances of edges (e,) are; at least 1."""
    scale = 1.0
    for _ in range(SCALE_ROUNDS):
        moments = student.weight(squared / scale) * squared + scale * share
        scale = max(1.0, float((COMMON_PRIOR + moments.sum()) / (COMMON_PRIOR + counts.sum())))
    return min(scale, LARGEST_KINSHIP)


def _residuals(group: Group, found: Refinement, noise: NoiseModel) -> Residuals:
    factor = pose_factor(group, found.tracks, found.edges)
    state = State(found.placement.world_from_camera, found.world_from_object)
    problem = Problem((factor,), np.arange(len(state.world_from_camera)) == 0)
    pose = se3.inverse(state.world_from_camera)[factor.camera] @ state.world_from_object[factor.object]
    obj_id = group.estimates.obj_id[found.tracks.estimate[found.edges.track]]
    centre = np.array([group.catalogue[int(o)].box_centre() for o in obj_id])
    axes, factors = viewing_axes(pose, centre), noise.factors(obj_id)
    return Residuals(
        obj_id=obj_id,
        deviation=np.einsum("eij,ej->ei", axes, se3.minus(factor.observed, pose)),
        expected=congruent(axes / factors[:, :, None], inverse(factor.information)),
        place=congruent(axes, problem.edge_covariances(state, factor)),
        factors=factors,
        distance=np.linalg.norm(centre_in_camera(pose, centre), axis=-1),
        unlike=_unlike(pose, centre, factor.object),
    )


def _unlike(camera_from_object: FloatArray, centre: FloatArray, obj: IntArray) -> BoolArray:
    """(e,) whether no other edge of the same object looks at it from a like direction."""
    ray = centre_in_camera(camera_from_object, centre)
    seen_from = np.einsum(
        "eji,ej->ei", camera_from_object[:, :3, :3], ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    )
    alike = (obj[:, None] == obj) & (seen_from @ seen_from.T > ALIKE)
    return np.sum(alike, axis=1) == 1
