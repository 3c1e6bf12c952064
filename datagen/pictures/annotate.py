"""Labels from render passes: masks, amodal boxes, visible share, keypoints; checked against our own z-buffer.

The index and depth passes say what is seen. What would be seen of an object if nothing hid it comes from
`multicam.geometry.rasterizer`, on a canvas that reaches one image beyond each border. The two know nothing of each
other, so wherever both speak they must agree; a scene in which they do not is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.pictures.renderer import Passes
from datagen.scenes.spec import SceneSpec
from multicam.dataset.bop_writer import InstanceLabels
from multicam.dataset.objects import Catalogue
from multicam.errors import DataError
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import NEAR, render_depth
from multicam.types import FloatArray

_DEPTH_TOLERANCE = 1e-3
"""Metres by which the two depths of a surface may differ."""
_PIXEL_TOLERANCE = 0.5
"""Pixels by which a keypoint may leave the silhouette of its object."""
_ZOOM = 32
"""Sides of a pixel where a sharp tip is looked for that passes between the centres of pixels."""
_STRAY_PIXELS, _STRAY_SHARE = 3, 0.01
"""How many pixels of an outline may fall differently in float32 and float64."""
_KEYPOINT_DEPTH = 2e-3
"""Metres that a visible keypoint may lie behind the surface at its pixel, besides half a pixel's footprint."""


def annotate(
    passes: Passes, scene: SceneSpec, shot: int, catalogue: Catalogue, meshes: dict[int, Mesh]
) -> tuple[InstanceLabels, ...]:
    """Labels of every object whose silhouette touches the image, hidden or not, in the order of the scene.

    Raises:
        DataError: render and geometry disagree; the sentence names scene, shot and object.
    """
    camera = scene.shots[shot].camera
    camera_from_world = se3.inverse(scene.shots[shot].world_from_camera)
    labels: list[InstanceLabels] = []
    for index, item in enumerate(scene.objects_in(shot)):
        pose = camera_from_world @ item.world_from_object
        silhouette = _silhouette(meshes[item.obj_id], camera, pose)
        visible = passes.index == index + 1
        where = f"{scene.name}, picture {shot}, object {index} (class {item.obj_id})"
        if silhouette is None:
            if visible.any():
                raise DataError(f"{where}: rendered inside the image, but its geometry lies outside.")
            continue
        inside = silhouette.inside(camera)
        _verify_depth(inside, passes.depth, visible, where)
        points = catalogue[item.obj_id].keypoints
        keypoints_in_camera = se3.act(pose, points if points is not None else np.zeros((0, 3)))
        # A point beside the camera has no image; it is moved to the near plane and is never visible.
        keypoints_in_camera[:, 2] = np.maximum(keypoints_in_camera[:, 2], NEAR)
        keypoints = camera.project(keypoints_in_camera)
        for number in silhouette.strays(keypoints, keypoints_in_camera[:, 2]):
            _verify_keypoint(keypoints[number], meshes[item.obj_id], camera, pose, where)
        labels.append(
            InstanceLabels(
                obj_id=item.obj_id,
                camera_from_object=pose,
                box=silhouette.box,
                mask=inside > 0,
                mask_visible=visible,
                visible_fraction=min(1.0, float(visible.sum()) / silhouette.pixel_count),
                pixel_count=max(silhouette.pixel_count, int(visible.sum())),
                keypoints=keypoints,
                keypoints_visible=_keypoints_visible(camera, keypoints, keypoints_in_camera[:, 2], passes.depth),
            )
        )
    return tuple(labels)


@dataclass(frozen=True, eq=False)
class _Silhouette:
    """An object drawn alone, on a canvas that holds the image and all of the object within one image around it.

    Attributes:
        depth: (h, w) of the canvas, 0 beside the object.
        start: (2,) x and y of the canvas's first pixel in the image.
        box: (4,) amodal, pixels.
    """

    depth: NDArray[np.float32]
    start: NDArray[np.int64]
    box: FloatArray

    @property
    def pixel_count(self) -> int:
        return int((self.depth > 0).sum())

    def inside(self, camera: Camera) -> NDArray[np.float32]:
        """The part within the image."""
        left, top = -self.start
        return self.depth[top : top + camera.height, left : left + camera.width]

    def strays(self, keypoints: FloatArray, depths: FloatArray) -> list[int]:
        """Keypoints before the camera and on the canvas that are more than half a pixel from every pixel of it."""
        local = keypoints - self.start
        height, width = self.depth.shape
        found: list[int] = []
        for number in np.flatnonzero(depths > NEAR):
            u, v = local[number]
            if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
                continue
            # A pixel is a square: half a pixel from its edge is a whole one from its centre.
            rows = slice(int(np.ceil(max(v - 1, 0))), int(v + 1) + 1)
            columns = slice(int(np.ceil(max(u - 1, 0))), int(u + 1) + 1)
            if not self.depth[rows, columns].any():
                found.append(int(number))
        return found


def _silhouette(mesh: Mesh, camera: Camera, camera_from_object: FloatArray) -> _Silhouette | None:
    """None if nothing of the object is in the image."""
    width, height = camera.width, camera.height
    points = se3.act(camera_from_object, mesh.vertices)
    front = points[:, 2] > NEAR
    if not front.any():
        return None
    low, high = np.array([-width, -height]), np.array([2 * width - 1, 2 * height - 1])
    box = np.concatenate((low - 0.5, high + 0.5))
    if front.all():
        pixels = camera.project(points)
        box = np.concatenate((np.maximum(pixels.min(0), low - 0.5), np.minimum(pixels.max(0), high + 0.5)))
    start, stop = np.ceil(box[:2]).astype(int), np.floor(box[2:]).astype(int) + 1
    # The canvas holds the image too, so that cutting the image out of it needs no special cases.
    start, stop = np.minimum(start, 0), np.maximum(stop, (width, height))
    if box[0] > width - 0.5 or box[1] > height - 0.5 or box[2] < -0.5 or box[3] < -0.5:
        return None
    shift = np.array([[1, 0, -start[0]], [0, 1, -start[1]], [0, 0, 1.0]])
    canvas = render_depth(mesh, camera.warped(shift, *(int(n) for n in stop - start)), camera_from_object)
    if not front.all():
        ys, xs = np.nonzero(canvas)
        if len(xs):
            corners = [xs.min() - 0.5, ys.min() - 0.5, xs.max() + 0.5, ys.max() + 0.5]
            box = np.array(corners, dtype=np.float64) + np.concatenate((start, start))
    found = _Silhouette(canvas, start, box.astype(np.float64))
    return found if found.inside(camera).any() else None


def _keypoints_visible(
    camera: Camera, keypoints: FloatArray, depths: FloatArray, scene_depth: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """A keypoint is seen if it lies in the image and nothing lies before it at its pixel."""
    inside = camera.contains(keypoints) & (depths > NEAR)
    columns = np.clip(np.rint(keypoints[:, 0]), 0, camera.width - 1).astype(int)
    rows = np.clip(np.rint(keypoints[:, 1]), 0, camera.height - 1).astype(int)
    surface = scene_depth[rows, columns]
    tolerance = _KEYPOINT_DEPTH + 0.5 * depths / camera.matrix[0, 0]
    return inside & ((surface == 0) | (depths < surface + tolerance))


def _verify_depth(own: NDArray[np.float32], seen: NDArray[np.float32], visible: NDArray[np.bool_], where: str) -> None:
    """Pixels the renderer gave to the object must have the object's depth, and no surface may lie behind it."""
    differs = visible & (np.abs(own - seen) > _DEPTH_TOLERANCE)
    through = ~visible & (own > 0) & (seen > own + _DEPTH_TOLERANCE)
    strays = int(differs.sum() + through.sum())
    if strays > _STRAY_PIXELS + _STRAY_SHARE * int(visible.sum()):
        raise DataError(
            f"{where}: rendered and computed depth differ by more than 1 mm at {strays} of {int(visible.sum())} "
            "pixels; labels would be wrong. Are two of its faces, or two objects, in the same place?"
        )


def _verify_keypoint(
    keypoint: FloatArray, mesh: Mesh, camera: Camera, camera_from_object: FloatArray, where: str
) -> None:
    """Keypoints lie on the surface, so the object must be found within half a pixel, if only between pixel centres."""
    corner = keypoint - _PIXEL_TOLERANCE
    zoom = np.array([[_ZOOM, 0, -_ZOOM * corner[0]], [0, _ZOOM, -_ZOOM * corner[1]], [0, 0, 1.0]])
    side = round(2 * _PIXEL_TOLERANCE * _ZOOM) + 1
    if not render_depth(mesh, camera.warped(zoom, side, side), camera_from_object).any():
        raise DataError(
            f"{where}: nothing of the object is within half a pixel of its keypoint at ({keypoint[0]:.1f}, "
            f"{keypoint[1]:.1f}); does keypoints.json belong to these meshes?"
        )
