"""Whether the pose of a camera, as measured at one time step, may change the stored one; if not, why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.geometry import se3
from multicam.scenegraph.graph import SceneGraph
from multicam.scenegraph.uncertain import UncertainPose
from multicam.types import Component


@dataclass(frozen=True)
class KeyframeConfig:
    """Conditions on a measurement; the filter adds its own: it must agree, and sharpen what is stored."""

    min_objects: int = 2
    """Objects on which the camera agrees with another one."""
    max_speed: float = 0.3
    """Of the headset, metres per second."""
    max_turn_deg: float = 30.0
    """Of the headset, degrees per second."""
    max_rotation_std_deg: float = 3.0
    """About the least certain axis."""
    max_translation_std: float = 0.05
    """Metres, along the least certain direction."""


def relative_in(component: Component, target: str, source: str) -> UncertainPose:
    """target_from_source of two views of a registered component.

    Exact where one of them is the component's first camera. The covariances of two others are relative to it and
    count as independent, which overstates the uncertainty of cameras that share more with each other than with it.
    """
    poses = {c.view_id: UncertainPose(c.world_from_camera, c.covariance) for c in component.cameras}
    return poses[target].inverse() @ poses[source]


def agreeing_objects(component: Component, view_id: str) -> int:
    """Number of objects on which a view agrees with at least one other."""
    supporters = [{view for view, _ in placed.supports} for placed in component.objects]
    return sum(view_id in views and len(views) > 1 for views in supporters)


def weakness(component: Component, source: str, measured: UncertainPose, config: KeyframeConfig) -> str:
    """Why a measured pose of the camera `source` is too weak to be stored; empty if it is not."""
    count = agreeing_objects(component, source)
    if count < config.min_objects:
        return f"only {count} of the {config.min_objects} objects needed agree with another camera"
    rotation_deg, translation = np.degrees(measured.rotation_std), measured.translation_std
    if rotation_deg > config.max_rotation_std_deg or translation > config.max_translation_std:
        return f"the measured pose is uncertain by {translation * 1000:.0f} mm and {rotation_deg:.1f} deg"
    return ""


def haste(graph: SceneGraph, config: KeyframeConfig) -> str:
    """Why the headset moves too fast to place others (blur, time offsets); empty if it does not."""
    turn, speed = headset_speed(graph)
    if speed > config.max_speed or np.degrees(turn) > config.max_turn_deg:
        return f"the headset moves too fast ({speed:.2f} m/s, {np.degrees(turn):.0f} deg/s)"
    return ""


def headset_speed(graph: SceneGraph) -> tuple[float, float]:
    """(rad/s, m/s) between the last two tracked poses; zero before there are two."""
    if len(graph.trajectory) < 2:
        return 0.0, 0.0
    earlier, later = graph.trajectory[-2:]
    seconds = (later.timestamp_ns - earlier.timestamp_ns) * 1e-9
    twist = se3.minus(later.world_from_headset, earlier.world_from_headset)
    distance = np.linalg.norm(later.world_from_headset[:3, 3] - earlier.world_from_headset[:3, 3])
    return float(np.linalg.norm(twist[:3])) / seconds, float(distance) / seconds
