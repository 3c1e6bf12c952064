import numpy as np

from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.visualization.overlay import GREY, Outline, color_of, draw_outlines, silhouette
from tests.toy_objects import PLATE, toy_meshes

MESH = toy_meshes()[PLATE]  # 120 x 60 x 20 mm
AWAY = se3.from_parts(np.eye(3), np.array([0, 0, 0.5]))


def test_a_silhouette_follows_the_projected_box():
    camera = Camera.from_focal(500.0, 640, 480)
    (contour,) = silhouette(MESH, camera, AWAY)
    # The front face is 0.49 m away: half sizes 500 * 60 / 490 and 500 * 30 / 490 pixels about the centre.
    low, high = contour[:, 0].min(0), contour[:, 0].max(0)
    np.testing.assert_allclose(low, [319.5 - 61.2, 239.5 - 30.6], atol=1)
    np.testing.assert_allclose(high, [319.5 + 61.2, 239.5 + 30.6], atol=1)


def test_an_object_out_of_sight_has_no_silhouette():
    camera = Camera.from_focal(500.0, 640, 480)
    assert silhouette(MESH, camera, se3.from_parts(np.eye(3), np.array([5.0, 0, 0.5]))) == []
    assert silhouette(MESH, camera, se3.from_parts(np.eye(3), np.array([0, 0, -0.5]))) == []


def test_small_pictures_are_enlarged_and_the_original_is_left_alone():
    camera = Camera.from_focal(125.0, 160, 120)
    image = np.full((120, 160, 3), 60, dtype=np.uint8)
    drawn = draw_outlines(image, camera, [Outline(MESH, AWAY, color_of(PLATE))])
    assert drawn.shape == (480, 640, 3)
    assert (image == 60).all()
    changed = np.argwhere((drawn != 60).any(axis=2))
    # The outline lies where the full-size camera would have it, to the width of the line.
    np.testing.assert_allclose(changed.min(0), [239.5 - 30.6, 319.5 - 61.2], atol=4)
    np.testing.assert_allclose(changed.max(0), [239.5 + 30.6, 319.5 + 61.2], atol=4)


def test_lines_have_the_colour_asked_for():
    camera = Camera.from_focal(500.0, 640, 480)
    drawn = draw_outlines(np.zeros((480, 640, 3), dtype=np.uint8), camera, [Outline(MESH, AWAY, GREY, bold=True)])
    assert tuple(drawn.reshape(-1, 3).max(0)) == GREY
