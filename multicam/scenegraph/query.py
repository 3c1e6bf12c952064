"""Relative poses of any two cameras at any time, by chaining links through space and time."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from multicam.scenegraph.graph import WORLD, Key, SceneGraph, key_of
from multicam.scenegraph.uncertain import UncertainPose

EXTENT = 1.0
"""Metres in front of a camera at which the uncertainties of rotation and translation are compared."""


@dataclass(frozen=True, eq=False)
class Chain:
    """A pose found by following links.

    Attributes:
        estimate: target_from_source with the covariance of the whole chain; links count as independent.
        nodes: from the target to the source, both included.
        updated_ns: time of the oldest link on the way, or None if there is none but tracking.
    """

    estimate: UncertainPose
    nodes: tuple[str, ...]
    updated_ns: int | None


def relative(graph: SceneGraph, target: str, source: str, timestamp_ns: int) -> Chain | None:
    """target_from_source at a time, along the most certain chain of links; None if nothing connects the two.

    Nodes are the world, the headset (where its tracking knows that time) and the static cameras. Two cameras that
    never see a common object are linked through the world, that is, through the headset that met both. Each step of
    the search extends the chain by `Ad(c_from_b) Cov_ab Ad(c_from_b)^T + Cov_bc`; links to the world have aged.
    """
    queue: list[tuple[float, int, Chain]] = [(0.0, 0, Chain(_certain(), (target,), None))]
    done: set[str] = set()
    pushed = 0
    while queue:
        _, _, chain = heapq.heappop(queue)
        node = chain.nodes[-1]
        if node == source:
            return chain
        if node in done:
            continue
        done.add(node)
        for other, step, updated_ns in _neighbours(graph, node, timestamp_ns):
            if other not in done:
                pushed += 1
                times = [t for t in (chain.updated_ns, updated_ns) if t is not None]
                longer = Chain(chain.estimate @ step, (*chain.nodes, other), min(times, default=None))
                heapq.heappush(queue, (spread(longer.estimate), pushed, longer))
    return None


def in_world(graph: SceneGraph, camera_id: str, timestamp_ns: int) -> Chain | None:
    """world_from_camera at a time."""
    return relative(graph, WORLD, camera_id, timestamp_ns)


def link_at(graph: SceneGraph, key: Key, timestamp_ns: int) -> UncertainPose:
    """A stored link as known at a time, aged since its last update.

    Raises:
        KeyError: there is no such link.
    """
    filtered = graph.links[key]
    return filtered.at(timestamp_ns, graph.drift_of(key, filtered.stored.pose))


def spread(estimate: UncertainPose) -> float:
    """Standard deviation (m) of a point at EXTENT metres, for comparing chains."""
    variances = np.diag(estimate.covariance)
    return float(np.sqrt(variances[3:].sum() + EXTENT**2 * variances[:3].sum()))


def _neighbours(graph: SceneGraph, node: str, timestamp_ns: int) -> Iterator[tuple[str, UncertainPose, int | None]]:
    """(other node, node_from_other, time of the link) of each link at a node."""
    if node in (WORLD, graph.headset):
        tracked = graph.tracked(timestamp_ns)
        if tracked is not None:
            step = UncertainPose(tracked, graph.config.tracking.jitter)
            yield (graph.headset, step, None) if node == WORLD else (WORLD, step.inverse(), None)
    for other in (WORLD, *graph.statics):
        key = key_of(node, other)
        if other != node and key in graph.links:
            step = link_at(graph, key, timestamp_ns)
            yield other, step if key[0] == node else step.inverse(), graph.links[key].updated_ns


def _certain() -> UncertainPose:
    return UncertainPose(np.eye(4), np.zeros((6, 6)))
