"""The scene graph in a browser, live (viser; extra `view`)."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.dataset.runs import StepResult
from multicam.errors import MissingDependencyError
from multicam.geometry import so3
from multicam.types import FloatArray, Frame
from multicam.visualization.overlay import color_of
from multicam.visualization.topview import STATUS_COLORS

FRUSTUM_SCALE = 0.08
"""Metres from a camera's centre to the plane on which its picture is shown."""


class Viewer:
    """A web server on this machine that shows the latest step: cameras with their pictures, objects as meshes."""

    def __init__(self, catalogue: Catalogue, port: int) -> None:
        """Starts the server.

        Raises:
            MissingDependencyError: viser is not installed.
        """
        try:
            import viser
        except ModuleNotFoundError as error:
            raise MissingDependencyError(
                '--view needs the package "viser", which is not installed: pip install "multicam-pose[view]".'
            ) from error
        self._server = viser.ViserServer(host="localhost", port=port, verbose=False)
        self._mesh_of = functools.cache(lambda obj_id: catalogue[obj_id].load_mesh())
        self._shown: set[str] = set()
        self.url = f"http://localhost:{self._server.get_port()}"

    def show(self, step: StepResult, frames: Sequence[Frame]) -> None:
        """Replaces what is shown by this step."""
        pictures = {frame.camera_id: frame for frame in frames}
        names: set[str] = set()
        with self._server.atomic():
            for camera in step.cameras:
                frame = pictures.get(camera.camera_id)
                if camera.world_from_camera is not None and frame is not None:
                    names.add(self._show_camera(frame, camera.world_from_camera, STATUS_COLORS[camera.status]))
            for item in step.objects:
                names.add(self._show_object(item.instance, item.obj_id, item.world_from_object))
            for name in self._shown - names:
                self._server.scene.remove_by_name(name)
        self._shown = names

    def stop(self) -> None:
        """Ends the server."""
        self._server.stop()

    def _show_camera(self, frame: Frame, world_from_camera: FloatArray, color: str) -> str:
        name = f"/cameras/{frame.camera_id}"
        self._server.scene.add_camera_frustum(
            name,
            fov=2 * float(np.arctan2(frame.camera.height / 2, frame.camera.matrix[1, 1])),
            aspect=frame.camera.width / frame.camera.height,
            scale=FRUSTUM_SCALE,
            color=_rgb(color),
            image=frame.image,
            **_pose(world_from_camera),
        )
        return name

    def _show_object(self, instance: int, obj_id: int, world_from_object: FloatArray) -> str:
        name, mesh = f"/objects/{instance}", self._mesh_of(obj_id)
        self._server.scene.add_mesh_simple(
            name, mesh.vertices, mesh.faces, color=color_of(obj_id), **_pose(world_from_object)
        )
        return name


def _rgb(color: str) -> tuple[int, int, int]:
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue


def _pose(transform: FloatArray) -> dict[str, Any]:
    return {"wxyz": so3.to_quaternion(transform[:3, :3]), "position": transform[:3, 3]}
