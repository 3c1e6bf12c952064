"""The world from above: static cameras with their uncertainty, the headset's path, the objects."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from multicam.dataset.runs import RunResult, StepResult
from multicam.types import FloatArray
from multicam.visualization.overlay import color_of

STATUS_COLORS = {"tracked": "#3b6fd4", "placed": "#2f9e57", "kept": "#d79a1e", "not placed": "#b8bcc4"}
TRUTH_COLOR = "#8a8f99"

ELLIPSE_95 = 5.991464547107979
"""95 % quantile of chi-square with 2 degrees of freedom."""

MARGIN = 0.15
"""Metres of border around what is drawn."""

WIDTH_INCHES, HEIGHT_INCHES = 9.6, (3.6, 7.2)


@dataclass(frozen=True, eq=False)
class TrueWorld:
    """Truth in the frame of the tracking, which equals the true world at the headset's first tracked pose.

    Attributes:
        headset: (n, 4, 4) true poses of the headset at the steps that have its picture.
        statics: true poses by static camera.
    """

    headset: FloatArray
    statics: Mapping[str, FloatArray]


class TopView:
    """Draws steps of one run on alike axes."""

    def __init__(self, run: RunResult, truth: TrueWorld | None) -> None:
        self._run, self._truth = run, truth
        poses = [c.world_from_camera for s in run.steps for c in s.cameras if c.world_from_camera is not None]
        self._plane = floor_axes(np.stack(poses)) if poses else np.eye(3)[:2]
        self._limits = self._extent(poses)

    def draw(self, step: StepResult) -> bytes:
        """PNG of one step; the headset's path is drawn up to it."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        across, along = self._limits[1] - self._limits[0]
        height = np.clip(WIDTH_INCHES * along / across, *HEIGHT_INCHES)
        figure = Figure(figsize=(WIDTH_INCHES, float(height)), dpi=110, layout="constrained")
        FigureCanvasAgg(figure)
        axes: Any = figure.add_subplot()
        self._draw_path(axes, step)
        if self._truth is not None:
            for pose in self._truth.statics.values():
                self._draw_camera(axes, pose, TRUTH_COLOR, filled=False)
        for item in step.objects:
            color = tuple(channel / 255 for channel in color_of(item.obj_id))
            x, y = self._plane @ item.world_from_object[:3, 3]
            axes.plot(x, y, "o", color=color, markersize=7, markeredgecolor="#333", markeredgewidth=0.6, zorder=4)
        for camera in step.cameras:
            if camera.world_from_camera is None or camera.covariance is None:
                continue
            color = STATUS_COLORS[camera.status]
            self._draw_camera(axes, camera.world_from_camera, color, filled=True)
            if camera.camera_id != self._run.headset:
                self._draw_ellipse(axes, camera.world_from_camera, camera.covariance, color)
            self._draw_name(axes, camera.camera_id, camera.world_from_camera)
        self._finish(axes)
        out = io.BytesIO()
        figure.savefig(out, format="png")
        return out.getvalue()

    def _draw_path(self, axes: Any, step: StepResult) -> None:
        headsets = [s.camera(self._run.headset) for s in self._run.steps]
        until = [s.timestamp_ns <= step.timestamp_ns for s in self._run.steps]
        points = [h.world_from_camera[:3, 3] for h in headsets if h.world_from_camera is not None]
        past = [
            h.world_from_camera[:3, 3]
            for h, done in zip(headsets, until, strict=True)
            if done and h.world_from_camera is not None
        ]
        if self._truth is not None and len(self._truth.headset):
            flat = self._truth.headset[:, :3, 3] @ self._plane.T
            axes.plot(*flat.T, "--", color=TRUTH_COLOR, linewidth=1.2, label="headset, truth", zorder=1)
        if points:
            axes.plot(*(np.array(points) @ self._plane.T).T, color="#c9d7f2", linewidth=1.6, zorder=1)
        if past:
            flat = (np.array(past) @ self._plane.T).T
            axes.plot(*flat, color=STATUS_COLORS["tracked"], linewidth=1.8, label="headset, tracked", zorder=2)

    def _draw_camera(self, axes: Any, world_from_camera: FloatArray, color: str, filled: bool) -> None:
        """A wedge with its tip at the camera's centre, opening along the optical axis."""
        corners = np.array([[0, 0, 0], [-0.05, 0, 0.11], [0.05, 0, 0.11]])
        flat = (corners @ world_from_camera[:3, :3].T + world_from_camera[:3, 3]) @ self._plane.T
        style: dict[str, Any] = {"facecolor": color, "alpha": 0.85} if filled else {"fill": False, "linestyle": "--"}
        from matplotlib.patches import Polygon

        axes.add_patch(Polygon(flat, edgecolor=color if not filled else "#333", linewidth=1.0, zorder=3, **style))

    def _draw_name(self, axes: Any, name: str, world_from_camera: FloatArray) -> None:
        """The name, behind the camera where the wedge leaves room."""
        backward = -(self._plane @ world_from_camera[:3, 2])
        shift = 14 * backward / max(float(np.linalg.norm(backward)), 1e-9)
        style = {"textcoords": "offset points", "ha": "center", "va": "center", "fontsize": 9}
        axes.annotate(name, self._plane @ world_from_camera[:3, 3], shift, **style)

    def _draw_ellipse(self, axes: Any, world_from_camera: FloatArray, covariance: FloatArray, color: str) -> None:
        """95 % of where the camera's centre may be, seen from above."""
        from matplotlib.patches import Ellipse

        in_plane = self._plane @ world_from_camera[:3, :3]
        variances, directions = np.linalg.eigh(in_plane @ covariance[3:, 3:] @ in_plane.T)
        width, height = 2 * np.sqrt(ELLIPSE_95 * np.maximum(variances, 0))
        angle = np.degrees(np.arctan2(directions[1, 0], directions[0, 0]))
        centre = self._plane @ world_from_camera[:3, 3]
        axes.add_patch(
            Ellipse(tuple(centre), width, height, angle=angle, facecolor=color, alpha=0.25, edgecolor=color, zorder=2)
        )

    def _extent(self, poses: Sequence[FloatArray]) -> FloatArray:
        """(2, 2) least and greatest coordinates on the floor of cameras and objects of all steps."""
        objects = [o.world_from_object for s in self._run.steps for o in s.objects]
        truth = [] if self._truth is None else [*self._truth.headset, *self._truth.statics.values()]
        everything = [*poses, *objects, *truth]
        if not everything:
            return np.array([[-1.0, -1.0], [1.0, 1.0]])
        flat = np.stack([pose[:3, 3] for pose in everything]) @ self._plane.T
        return np.stack((flat.min(0) - MARGIN, flat.max(0) + MARGIN))

    def _finish(self, axes: Any) -> None:
        axes.set_xlim(*self._limits[:, 0])
        axes.set_ylim(*self._limits[:, 1])
        axes.set_aspect("equal", adjustable="box")
        axes.set_xlabel("m", fontsize=8)
        axes.tick_params(labelsize=8)
        axes.grid(color="#e6e8ec", linewidth=0.6)
        axes.set_axisbelow(True)
        for side in axes.spines.values():
            side.set_color("#c4c8d0")
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="best", fontsize=8, frameon=False)


def floor_axes(world_from_cameras: FloatArray) -> FloatArray:
    """(2, 3) two axes of the world that span the floor, so that the third points up to the eye.

    Up is the axis of the world nearest to the mean of the cameras' upward (-y) and backward (-z) directions: cameras
    that look down at a table by any angle between level and plumb have it between the two.
    """
    upward = -(world_from_cameras[:, :3, 1] + world_from_cameras[:, :3, 2]).mean(0)
    axis = int(np.argmax(np.abs(upward)))
    up = np.sign(upward[axis]) * np.eye(3)[axis]
    first = np.eye(3)[(axis + 1) % 3]
    return np.stack((first, np.cross(up, first)))
