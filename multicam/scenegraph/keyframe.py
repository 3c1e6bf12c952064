"""The headset over time: where it is now by its tracking, and which of its views are kept."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from multicam.geometry import se3
from multicam.scenegraph.config import GraphConfig, KeyframeConfig
from multicam.scenegraph.graph import SceneGraph, Stay, Tracking
from multicam.scenegraph.prune import is_whole
from multicam.scenegraph.uncertain import UncertainPose, spread
from multicam.types import FloatArray

_CERTAIN = UncertainPose(np.eye(4), np.zeros((6, 6)))


def track(graph: SceneGraph, timestamp_ns: int, tracking_from_headset: FloatArray) -> tuple[SceneGraph, str]:
    """Moves the headset to where its tracking says, from its last keyframe on; after a keyframe without tracking its
    pose is open.

    Args:
        timestamp_ns: later than that of the last tracked pose.

    Returns:
        The graph, and why the headset measures nothing at this step (it moves too fast); empty if it does measure.
    """
    last = graph.tracking
    since, hurry = _CERTAIN, ""
    if last is not None:
        seconds = (timestamp_ns - last.timestamp_ns) * 1e-9
        motion = se3.inverse(last.tracking_from_headset) @ tracking_from_headset
        hurry = haste(motion, seconds, graph.config.keyframes)
        drift = UncertainPose(motion, seconds * graph.config.tracking.drift_per_second)
        since = last.since_keyframe @ drift
    tracking = Tracking(timestamp_ns, tracking_from_headset, since)
    if graph.keyframes and last is None:
        return replace(graph, tracking=tracking), hurry
    if graph.keyframes:
        pose = graph.keyframes[-1].world_from_camera @ since.pose
        now = Stay(graph.headset, timestamp_ns, timestamp_ns, pose, odometry=since)
    else:
        now = Stay(graph.headset, timestamp_ns, timestamp_ns, tracking_from_headset)
    return replace(graph, tracking=tracking, now=now), hurry


def haste(motion: FloatArray, seconds: float, config: KeyframeConfig) -> str:
    """Why a headset that moves so within some seconds measures nothing; empty if it does."""
    speed = float(np.linalg.norm(motion[:3, 3])) / seconds
    turn_deg = float(np.degrees(np.linalg.norm(se3.log(motion)[:3]))) / seconds
    if speed > config.max_speed or turn_deg > config.max_turn_deg:
        return f"the headset moves too fast ({speed:.2f} m/s, {turn_deg:.0f} deg/s)"
    return ""


def keep(graph: SceneGraph, tracked: bool) -> SceneGraph:
    """Ends a step: what the headset sees becomes a keyframe, or joins the last one if it is much the same view.

    Args:
        tracked: whether the headset's tracking gave its pose at this step.
    """
    now = graph.now
    graph = replace(graph, now=None)
    if now is None or not now.edges:
        return graph
    if not tracked:
        # What it saw counts only if others hang on it: nobody knows how the headset came there, or where it goes.
        return graph if is_whole(graph) else replace(graph, keyframes=(*graph.keyframes, now), tracking=None)
    assert graph.tracking is not None
    if not begins(graph, now):
        assert now.odometry is not None
        joined = join(graph.keyframes[-1], now, now.odometry, graph.config)
        return replace(graph, keyframes=(*graph.keyframes[:-1], joined))
    tracking = replace(graph.tracking, since_keyframe=_CERTAIN)
    return cull(replace(graph, keyframes=(*graph.keyframes, now), tracking=tracking))


def begins(graph: SceneGraph, now: Stay) -> bool:
    """Whether where the headset is now is a new keyframe, and not much the same view as the last one."""
    if not graph.keyframes or now.odometry is None:
        return True
    return _gap(graph.keyframes[-1], now) >= graph.config.keyframes.spacing


def _gap(earlier: Stay, later: Stay) -> float:
    """How far two keyframes in a row are apart, metres, and how much tracking may have drifted between them.

    Turns, and their uncertainty, count by how far they move what is seen a metre away.
    """
    assert later.odometry is not None
    motion = se3.minus(later.world_from_camera, earlier.world_from_camera)
    return float(np.linalg.norm(motion[:3]) + np.linalg.norm(motion[3:])) + spread(later.odometry)


def join(into: Stay, later: Stay, motion: UncertainPose, config: GraphConfig) -> Stay:
    """A stay with the looks of a later one from nearby, given into_from_later."""
    edges = dict(into.edges)
    for number, edge in later.edges.items():
        moved = edge.seen_from(motion)
        edges[number] = edges[number].joined(moved, config) if number in edges else moved
    return replace(into, edges=edges, seen_ns=later.seen_ns)


def cull(graph: SceneGraph) -> SceneGraph:
    """Joins keyframes, those with the smallest gap first, until no more are left than are kept."""
    while len(graph.keyframes) > graph.config.keyframes.most:
        gaps = [
            np.inf if later.odometry is None else _gap(earlier, later) for earlier, later in pairwise(graph.keyframes)
        ]
        # The last one stays, for tracking goes on from it, and so does the first, which holds the world.
        index = int(np.argmin(gaps[:-1]))
        into, gone, after = graph.keyframes[index : index + 3]
        if gone.odometry is None:
            break
        bridge = None if after.odometry is None else gone.odometry @ after.odometry
        kept = join(into, gone, gone.odometry, graph.config), replace(after, odometry=bridge)
        graph = replace(graph, keyframes=(*graph.keyframes[:index], *kept, *graph.keyframes[index + 3 :]))
    return graph
