"""The worst answers of a method, drawn: the true outline, the estimated one, and the error in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from multicam.dataset.bop_reader import read_image
from multicam.dataset.objects import Catalogue
from multicam.evaluation.calibration import best_symmetry
from multicam.evaluation.camera_error import camera_error
from multicam.evaluation.selection import distance
from multicam.evaluation.single_view import ObjectErrors
from multicam.evaluation.single_view_tables import Errors
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.types import FloatArray, ImageArray
from multicam.visualization.overlay import Color, Outline, draw_outlines

TRUE_COLOR: Color = (80, 220, 100)
ESTIMATED_COLOR: Color = (255, 70, 200)

MOST_CASES = 18
_MARGIN = 0.4
"""Picture around both outlines, as a share of their size."""
_LEAST_WIDTH = 160
"""Pixels of the picture at least shown."""


@dataclass(frozen=True, eq=False)
class WorstCase:
    """A picture (h, w, 3) RGB with outlines, its heading and the error in words."""

    picture: ImageArray
    title: str
    text: str


def choose_worst(errors: Errors, catalogue: Catalogue) -> list[ObjectErrors]:
    """Of each class the answer with the greatest ADD(-S) and the object that was easiest to see and not found."""
    answered: list[ObjectErrors] = []
    missed: list[ObjectErrors] = []
    for found in errors.values():
        with_estimate = [e for e in found if e.estimate is not None]
        without = [e for e in found if e.estimate is None]
        answered += sorted(with_estimate, key=lambda e: -e.add_or_add_s)[:1]
        missed += sorted(without, key=lambda e: (-(e.truth.visible_fraction or 0.0), distance(e.truth)))[:1]
    answered.sort(key=lambda e: -e.add_or_add_s / catalogue[e.truth.obj_id].diameter)
    missed.sort(key=lambda e: -(e.truth.visible_fraction or 0.0))
    kept = max(MOST_CASES // 2, MOST_CASES - len(missed))
    answered = answered[:kept]
    return answered + missed[: MOST_CASES - len(answered)]


def draw_case(error: ObjectErrors, catalogue: Catalogue, mesh_of: Callable[[int], Mesh]) -> WorstCase:
    """Cuts out the part of the picture that shows both outlines.

    Raises:
        DataError: the picture or the mesh cannot be read.
    """
    record, truth = error.record, error.truth
    assert record.rgb_path is not None
    assert record.camera_matrix is not None, "the errors were taken with it"
    image, mesh = read_image(record.rgb_path), mesh_of(truth.obj_id)
    poses = [truth.camera_from_object]
    outlines = [Outline(mesh, truth.camera_from_object, TRUE_COLOR)]
    if error.estimate is not None:
        poses.append(error.estimate.camera_from_object)
        outlines.append(Outline(mesh, error.estimate.camera_from_object, ESTIMATED_COLOR))
    camera = Camera(record.camera_matrix, image.shape[1], image.shape[0])
    x0, y0, x1, y1 = _window(mesh, poses, camera)
    shift = np.array([[1, 0, -x0], [0, 1, -y0], [0, 0, 1]], dtype=np.float64)
    part, seen = image[y0:y1, x0:x1], camera.warped(shift, x1 - x0, y1 - y0)
    title = f"{catalogue[truth.obj_id].name}, scene {record.scene_id}, image {record.im_id}"
    return WorstCase(draw_outlines(np.ascontiguousarray(part), seen, outlines), title, in_words(error, catalogue))


def in_words(error: ObjectErrors, catalogue: Catalogue) -> str:
    """What is wrong with an answer."""
    visible = error.truth.visible_fraction
    seen = f"{distance(error.truth):.2f} m away" + ("" if visible is None else f", {100 * visible:.0f} % visible")
    if error.estimate is None:
        return f"not found; {seen}"
    off = camera_error(error.estimate.camera_from_object, best_symmetry(error, catalogue))
    diameters = error.add_or_add_s / catalogue[error.truth.obj_id].diameter
    return (
        f"ADD(-S) {1000 * error.add_or_add_s:.0f} mm ({diameters:.2g} diameters): {off.centre_mm:.0f} mm and "
        f"{off.rotation_deg:.0f}° off; {seen}; score {error.estimate.score:.2f}"
    )


def _window(mesh: Mesh, poses: Sequence[FloatArray], camera: Camera) -> tuple[int, int, int, int]:
    """x0 y0 x1 y1 of the part of the image around an object in all poses, with a margin, 4 wide to 3 high or more."""
    points = np.concatenate([se3.act(pose, mesh.vertices) for pose in poses])
    size = np.array([camera.width, camera.height])
    pixels = camera.project(points[points[:, 2] > 0])
    low, high = np.clip(pixels.min(axis=0), 0, size), np.clip(pixels.max(axis=0), 0, size)
    width = max(float((high - low).max()) * (1 + _MARGIN), _LEAST_WIDTH)
    half = np.minimum(np.array([width, 0.75 * width]), size) / 2
    centre = np.clip((low + high) / 2, half, size - half)
    start = np.floor(centre - half).astype(int)
    stop = np.minimum(start + np.ceil(2 * half).astype(int), size)
    return int(start[0]), int(start[1]), int(stop[0]), int(stop[1])
