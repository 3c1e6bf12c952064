"""Each edge by itself: where one picture shows one object, and how surely, whatever the other pictures say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from multicam.bundle.adjustment.config import AdjustmentConfig
from multicam.bundle.adjustment.descent import Participants, System
from multicam.bundle.adjustment.scene import Scene
from multicam.bundle.adjustment.search import edge_poses, learn_colors
from multicam.bundle.occlusion import Occluders
from multicam.bundle.pose import PoseFactor
from multicam.bundle.problem import State
from multicam.bundle.region.colors import ColorModel
from multicam.bundle.robust import Student
from multicam.types import FloatArray

FIRST_TRUST = 0.05
"""Share of the estimates' information that counts while colours are those at the estimates."""


def observe_edges(
    scene: Scene,
    world_from_camera: FloatArray,
    occluders: Sequence[Occluders],
    colors: Sequence[ColorModel],
    config: AdjustmentConfig,
) -> tuple[PoseFactor, Sequence[ColorModel]]:
    """Poses of all edges, refined from the estimates with the cameras fixed, with what picture and estimate know.

    Searching from where a picture's own estimate is, lines and points find the object even while the cameras are far
    from right; an object that was moved between two pictures disagrees here as a pose, which a robust cost can judge.

    Colours that were learnt at an estimate draw the contour towards it, so that the estimate would count twice. The
    first searches therefore ask it for little more than where to begin; then the colours are learnt anew.

    Args:
        colors: (e,) to begin with.

    Returns:
        The poses as observations, and the colours (e,) they were found by.
    """
    edges, cameras = len(scene.camera), len(scene.pictures)
    apart = replace(
        scene,
        bodies=[scene.bodies[o] for o in scene.object],
        object=np.arange(edges),
        fixed=np.ones(cameras, dtype=np.bool_),
        motions=(),
        bearings=(),
    )
    everyone = Participants(np.ones(cameras, dtype=np.bool_), np.ones(edges, dtype=np.bool_), apart.fixed)
    state = State(world_from_camera, world_from_camera[scene.camera] @ scene.estimated)
    if config.relearn:
        free = apart.trusted(FIRST_TRUST)
        state = System(free, everyone, occluders, colors, config).descend(state, range(config.relearn)).state
        colors = learn_colors(apart, edge_poses(apart, state), occluders, config)
    end = System(apart, everyone, occluders, colors, config).descend(state, config.last_searches)
    pose, information = edge_poses(apart, end.state), end.seen.hessian + scene.information
    factor = PoseFactor(scene.camera, scene.object, pose, information, Student(config.tail, 6))
    return factor, colors
