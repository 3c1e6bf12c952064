"""Where cameras are relative to each other, how well that is known, and by which others they hang together."""

from __future__ import annotations

from multicam.geometry import se3
from multicam.scenegraph.graph import SceneGraph
from multicam.scenegraph.solution import Solution, solve
from multicam.scenegraph.uncertain import UncertainPose


def relative(graph: SceneGraph, target: str, source: str) -> UncertainPose | None:
    """target_from_source of two static cameras (or the headset during a step), with all that ties them; None if one
    has no pose.

    Two cameras that never see a common object are tied through the headset that met both, at different times.
    """
    a, b = graph.index_of(target), graph.index_of(source)
    if a is None or b is None:
        return None
    return relative_in(solve(graph), a, b)


def relative_in(solution: Solution, target: int, source: int) -> UncertainPose:
    """As `relative`, of two of the graph's stays."""
    cameras, _ = solution.seen_from(target)
    pose = solution.state.world_from_camera
    return UncertainPose(se3.inverse(pose[target]) @ pose[source], cameras[source])


def chain(graph: SceneGraph, camera_id: str) -> tuple[str, ...]:
    """The shortest chain of cameras, each sharing objects with the next, from the headset to a camera.

    The headset alone where its own tracking gives its pose; empty for a camera without a pose.
    """
    goal, stays = graph.index_of(camera_id), graph.stays
    if goal is None:
        return ()
    if camera_id == graph.headset and (goal == 0 or stays[goal].odometry is not None):
        return (camera_id,)
    before: dict[int, int] = {}
    wave = [n for n in range(len(graph.path)) if n != goal]
    reached = set(wave)
    while wave and goal not in reached:
        following: list[int] = []
        for n in wave:
            neighbours = [m for m in range(len(stays)) if m not in reached and stays[n].edges.keys() & stays[m].edges]
            before |= dict.fromkeys(neighbours, n)
            reached |= set(neighbours)
            following += neighbours
        wave = following
    names, node = [camera_id], goal
    while node in before:
        node = before[node]
        if stays[node].camera_id != names[-1]:
            names.append(stays[node].camera_id)
    return tuple(reversed(names))
