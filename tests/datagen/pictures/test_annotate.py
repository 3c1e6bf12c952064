"""Labels from passes that are worked out by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from datagen.pictures.annotate import annotate
from datagen.pictures.renderer import Passes
from datagen.scenes.spec import PlacedInstance, SceneSpec, Shot, Surface, Surroundings
from multicam.dataset.bop_writer import InstanceLabels
from multicam.dataset.objects import Catalogue, ObjectModel
from multicam.errors import DataError
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import render_depth
from multicam.geometry.symmetry import Symmetries

CAMERA = Camera(np.array([[100.0, 0, 31.5], [0, 100, 23.5], [0, 0, 1]]), 64, 48)
HALF = 0.05
CORNERS = HALF * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
PLATE = Mesh(CORNERS, np.array([[0, 1, 2], [0, 2, 3]]))
"""A square of 10 cm that faces the camera; at 0.5 m it is 20 pixels wide."""


def catalogue(keypoints: np.ndarray) -> Catalogue:
    return Catalogue({1: ObjectModel(1, "plate", 0.14, Symmetries(), None, keypoints, Path("none"))})


def scene(*places: tuple[float, float, float]) -> SceneSpec:
    objects = tuple(PlacedInstance(1, se3.from_parts(np.eye(3), np.array(p)), Surface((1.0, 1, 1))) for p in places)
    return SceneSpec("seed 7, scene 8", 0, objects, (), (), Surroundings(1.0), (Shot(CAMERA, np.eye(4)),))


def label(passes: Passes, spec: SceneSpec, keypoints: np.ndarray = CORNERS) -> tuple[InstanceLabels, ...]:
    return annotate(passes, spec, 0, catalogue(keypoints), {1: PLATE})


def empty() -> Passes:
    flat = np.zeros((48, 64), np.float32)
    return Passes(np.zeros((48, 64, 3), np.float32), flat.copy(), flat.astype(np.uint16), flat.copy())


def paint(passes: Passes, index: int, depth: float, rows: slice, columns: slice) -> None:
    passes.index[rows, columns] = index
    passes.depth[rows, columns] = depth


def test_a_square_in_the_open() -> None:
    passes = empty()
    paint(passes, 1, 0.5, slice(14, 34), slice(22, 42))
    (row,) = label(passes, scene((0, 0, 0.5)))
    assert np.allclose(row.box, [21.5, 13.5, 41.5, 33.5])
    assert row.pixel_count == 400
    assert row.visible_fraction == 1
    assert np.array_equal(row.mask, passes.index == 1)
    assert np.allclose(row.keypoints, [[21.5, 13.5], [41.5, 13.5], [41.5, 33.5], [21.5, 33.5]])


def test_a_square_behind_another_is_half_visible() -> None:
    passes = empty()
    # The near one covers the left half of the far one: columns 12 to 31 at 0.25 m are 5 cm wide.
    paint(passes, 1, 0.5, slice(14, 34), slice(22, 42))
    paint(passes, 2, 0.25, slice(4, 44), slice(0, 32))
    inner = 0.8 * CORNERS
    far, near = label(passes, scene((0, 0, 0.5), (-0.05, 0, 0.25)), inner)
    assert far.visible_fraction == pytest.approx(0.5)
    assert far.mask.sum() == 400
    assert far.mask_visible.sum() == 200
    assert far.keypoints_visible.tolist() == [False, True, True, False]
    # The near one is cut by the left border: 40 pixels wide, of which 8 lie outside.
    assert near.box[0] == pytest.approx(-8.5)
    assert near.pixel_count == 1600
    assert near.visible_fraction == pytest.approx(32 / 40)
    assert near.keypoints_visible.tolist() == [False, True, True, False]


def test_a_wholly_hidden_object_is_labelled_and_one_beside_the_image_is_not() -> None:
    passes = empty()
    paint(passes, 0, 0.1, slice(0, 48), slice(0, 64))
    rows = label(passes, scene((0, 0, 0.5), (1.0, 0, 0.5), (0, 0, -0.5)))
    assert len(rows) == 1
    assert rows[0].visible_fraction == 0
    assert not rows[0].keypoints_visible.any()


def test_boxes_end_one_image_beyond_the_border() -> None:
    passes = empty()
    paint(passes, 1, 0.02, slice(0, 48), slice(0, 64))
    (row,) = label(passes, scene((0, 0, 0.02)))
    assert np.allclose(row.box, [-64.5, -48.5, 127.5, 95.5])
    assert row.pixel_count == 9 * 48 * 64


def test_an_object_beside_the_camera_gets_finite_labels() -> None:
    turned = se3.from_parts(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.array([0.02, 0, 0.03]))
    spec = scene((0, 0, 0.5))
    spec = SceneSpec(
        spec.name, 0, (PlacedInstance(1, turned, Surface((1.0, 1, 1))),), (), (), spec.surroundings, spec.shots
    )
    passes = empty()
    # The plane x = 0.02 lies at depth 0.02 / ((u - 31.5) / 100), as far as its edge at 0.08 m.
    columns = np.arange(64)
    depth = np.where(columns > 31.5 + 25, 2 / np.maximum(columns - 31.5, 1), 0)
    passes.depth[:], passes.index[:] = depth, depth > 0
    (row,) = label(passes, spec)
    assert np.all(np.isfinite(row.keypoints))
    assert np.all(np.isfinite(row.box))
    assert row.keypoints_visible.tolist() == [False] * 4


def test_disagreement_of_render_and_geometry_names_the_scene() -> None:
    passes = empty()
    paint(passes, 1, 0.51, slice(14, 34), slice(22, 42))
    with pytest.raises(DataError, match="seed 7, scene 8, picture 0, object 0"):
        label(passes, scene((0, 0, 0.5)))
    passes = empty()
    paint(passes, 1, 0.5, slice(14, 34), slice(24, 44))
    with pytest.raises(DataError, match="differ"):
        label(passes, scene((0, 0, 0.5)))


def test_a_surface_seen_through_the_object_is_a_disagreement() -> None:
    passes = empty()
    paint(passes, 0, 0.9, slice(0, 48), slice(0, 64))
    with pytest.raises(DataError, match="differ"):
        label(passes, scene((0, 0, 0.5)))


def test_keypoints_of_another_mesh_are_noticed() -> None:
    passes = empty()
    paint(passes, 1, 0.5, slice(14, 34), slice(22, 42))
    with pytest.raises(DataError, match=r"keypoints\.json"):
        label(passes, scene((0, 0, 0.5)), 1.2 * CORNERS)


NEEDLE = Mesh(np.array([[0, -0.004, 0], [0, 0.004, 0], [0.1, 0, 0]]), np.array([[0, 2, 1], [0, 1, 2]]))
"""20 pixels long at 0.5 m; its tip is far thinner than a pixel."""


@pytest.mark.parametrize("beyond", [0.0, 0.4])
def test_a_keypoint_on_a_tip_between_pixel_centres_is_right(beyond: float) -> None:
    row = needle_label(beyond)
    assert row.keypoints[0, 0] == pytest.approx(31.5 + 20 + beyond)
    assert not row.mask[23:25, 48:].any()


def test_a_keypoint_more_than_half_a_pixel_beyond_a_tip_is_noticed() -> None:
    with pytest.raises(DataError, match="within half a pixel"):
        needle_label(0.6)


def needle_label(beyond: float) -> InstanceLabels:
    """Of a keypoint that lies some pixels beyond the tip."""
    place = (0.0, 0.0013, 0.5)
    passes, pose = empty(), se3.from_parts(np.eye(3), np.array(place))
    passes.depth[:] = render_depth(NEEDLE, CAMERA, pose)
    passes.index[:] = passes.depth > 0
    keypoints = np.array([[0.1 + beyond * 0.5 / 100, 0, 0], [0.0, 0, 0]])
    (row,) = annotate(passes, scene(place), 0, catalogue(keypoints), {1: NEEDLE})
    return row
