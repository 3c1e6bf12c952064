"""All places and rests, most likely given every look and the headset's tracking; and how well each is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from multicam.bundle.levenberg import minimize
from multicam.bundle.odometry import OdometryFactor
from multicam.bundle.pose import PoseFactor
from multicam.bundle.problem import Problem, State
from multicam.bundle.robust import Student
from multicam.matching.arrays import BoolArray
from multicam.matching.linear import inverse
from multicam.registration.kinship import count_alike
from multicam.scenegraph.graph import SceneGraph
from multicam.scenegraph.uncertain import UncertainPose
from multicam.types import FloatArray

TAIL = 2.0
"""Degrees of freedom of the Student distribution of looks; small values expect many gross errors."""

DRIFT_PRIOR = 12.0
"""How many measured numbers the configured drift counts for against what the graph says of it."""


@dataclass(frozen=True, eq=False)
class Solution:
    """A graph at its most likely poses.

    Attributes:
        graph: with these poses.
        numbers: of the rests, in the order of the state's objects.
        noise_scale: how much larger the variances of looks are than stated.
    """

    graph: SceneGraph
    numbers: tuple[int, ...]
    problem: Problem
    state: State
    noise_scale: float

    def seen_from(self, stay: int) -> tuple[FloatArray, FloatArray]:
        """Covariances with one stay as gauge: of all stays (c, 6, 6), and of all rests (o, 6, 6), right tangents."""
        fixed = _one_of(len(self.state.world_from_camera), stay)
        return replace(self.problem, fixed=fixed).covariances(self.state, self.noise_scale)


def solve(graph: SceneGraph) -> Solution:
    """Moves all poses to the minimum; the first stay does not move.

    Every stay must hang together with the first one (see `reached`), and every rest be seen from one.
    """
    start = assess(graph)
    state = minimize(start.problem, start.state, graph.config.solver).state
    moved = tuple(
        replace(stay, world_from_camera=pose) for stay, pose in zip(graph.stays, state.world_from_camera, strict=True)
    )
    rests = {
        number: replace(graph.rests[number], world_from_object=pose)
        for number, pose in zip(start.numbers, state.world_from_object, strict=True)
    }
    noise_scale = start.problem.noise_scale(state)
    graph = replace(
        graph.with_stays(moved), rests=rests, drift_scale=_drift_scale(graph, start.problem, state, noise_scale)
    )
    return Solution(graph, start.numbers, start.problem, state, noise_scale)


def _drift_scale(graph: SceneGraph, problem: Problem, state: State, noise_scale: float) -> float:
    """One step of expectation-maximisation for the variance of the headset's drift; the next solution uses it."""
    expected = problem.expected_motion(state, noise_scale)
    if not len(expected):
        return graph.drift_scale
    return (DRIFT_PRIOR + graph.drift_scale * float(expected.sum())) / (DRIFT_PRIOR + 6 * len(expected))


def assess(graph: SceneGraph) -> Solution:
    """The graph as it is, as a problem: how well its poses are known without moving them."""
    numbers = tuple(sorted(graph.rests))
    stays = graph.stays
    position = {number: n for n, number in enumerate(numbers)}
    state = State(
        np.array([stay.world_from_camera for stay in stays]).reshape(-1, 4, 4),
        np.array([graph.rests[number].world_from_object for number in numbers]).reshape(-1, 4, 4),
    )
    edges = [(c, position[number], edge) for c, stay in enumerate(stays) for number, edge in stay.edges.items()]
    camera = np.array([c for c, _, _ in edges], dtype=np.int64)
    obj = np.array([o for _, o, _ in edges], dtype=np.int64)
    observed = np.array([edge.mean.pose for *_, edge in edges]).reshape(-1, 4, 4)
    covariance = np.array([edge.mean.covariance + edge.common for *_, edge in edges]).reshape(-1, 6, 6)
    centre = np.array([graph.rests[number].centre for number in numbers]).reshape(-1, 3)
    # Looks from like directions err alike: n of them count for n / (1 + (n - 1) share) (docs/registration.md).
    design = 1 + graph.config.common * (count_alike(observed, centre[obj], obj) - 1)
    looks = PoseFactor(camera, obj, observed, inverse(design[:, None, None] * covariance), Student(TAIL, 6))
    problem = Problem((looks,), _one_of(len(stays), 0), _motions(graph))
    return Solution(graph, numbers, problem, state, problem.noise_scale(state))


def _motions(graph: SceneGraph) -> tuple[OdometryFactor, ...]:
    """The headset's tracking between keyframes."""
    jitter = graph.config.tracking.jitter
    tracked = [
        (n, UncertainPose(later.odometry.pose, graph.drift_scale * later.odometry.covariance).inflated(jitter))
        for n, (_, later) in enumerate(pairwise(graph.path))
        if later.odometry is not None
    ]
    if not tracked:
        return ()
    first = np.array([n for n, _ in tracked], dtype=np.int64)
    covariance = np.stack([motion.covariance for _, motion in tracked])
    measured = np.stack([motion.pose for _, motion in tracked])
    return (OdometryFactor(first, first + 1, measured, inverse(covariance)),)


def _one_of(count: int, index: int) -> BoolArray:
    return np.arange(count) == index


def reached(graph: SceneGraph) -> set[int]:
    """Positions of the stays that hang together with the first one, over rests or tracking."""
    stays = graph.stays
    ties: list[set[int]] = [set(stay.edges) for stay in stays]
    found, wave = set[int](), {0} if stays else set[int]()
    while wave:
        found |= wave
        rests = set[int]().union(*(ties[n] for n in wave))
        wave = {n for n in range(len(stays)) if ties[n] & rests}
        for n, stay in enumerate(graph.path):
            if stay.odometry is not None and n > 0:
                wave |= {n - 1} if n in found else {n} if n - 1 in found else set()
        wave -= found
    return found
