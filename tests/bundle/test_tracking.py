"""A box followed through pictures of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from multicam.bundle.depth_image import DepthImage
from multicam.bundle.occlusion import Occluders
from multicam.bundle.region.colors import ColorModel
from multicam.bundle.region.config import RegionConfig
from multicam.bundle.tracking import Sight, TrackingConfig, first_colors, track, updated_colors
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from tests.bundle.box_world import COLOR_CAMERA, box_model, color_picture, constant_depth, pose, sight

CONFIG = TrackingConfig(searches=7)
REGION = RegionConfig()
STARTS = [[0.03, -0.02, 0.02, 0.004, 0.003, -0.006], [-0.02, 0.03, -0.03, -0.005, 0.004, 0.006]]


def error(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Millimetres and degrees."""
    xi = se3.minus(found, truth)
    return 1e3 * float(np.linalg.norm(xi[3:])), float(np.degrees(np.linalg.norm(xi[:3])))


def learnt(of: Sight) -> ColorModel:
    return first_colors(box_model(), of, pose(), REGION)


@pytest.mark.parametrize("start", STARTS)
def test_a_box_is_found_again_by_colour_and_depth(rng: np.random.Generator, start: list[float]) -> None:
    seen = sight(rng, pose())
    found = track(box_model(), [seen], [learnt(seen)], se3.plus(pose(), np.array(start)), CONFIG)
    millimetres, degrees = error(found.world_from_object, pose())
    assert millimetres < 0.5 and degrees < 0.7
    assert found.lines > 150 and found.points > 150 and np.isfinite(found.energy)
    assert np.linalg.eigvalsh(found.hessian)[0] > 0


@pytest.mark.parametrize("start", STARTS)
def test_a_box_is_found_again_by_colour_alone(rng: np.random.Generator, start: list[float]) -> None:
    seen = replace(sight(rng, pose()), depth=None)
    found = track(box_model(), [seen], [learnt(seen)], se3.plus(pose(), np.array(start)), CONFIG)
    millimetres, degrees = error(found.world_from_object, pose())
    assert millimetres < 4 and degrees < 1.5 and found.points == 0


def test_depth_alone_finds_a_box_that_has_moved(rng: np.random.Generator) -> None:
    seen = sight(rng, pose())
    found = track(
        box_model(), [seen], [ColorModel.uniform()], se3.plus(pose(), np.array(STARTS[0])), replace(CONFIG, region=None)
    )
    assert error(found.world_from_object, pose())[0] < 1.5 and found.lines == 0


def test_a_second_camera_gives_the_object_in_the_same_world(rng: np.random.Generator) -> None:
    world_from_camera = se3.random(rng)
    first, second = sight(rng, pose()), sight(rng, pose())
    cameras = [replace(first, camera_from_world=se3.inverse(world_from_camera))]
    # The same picture from a camera of the same place: any disagreement between the frames would show.
    cameras.append(replace(second, camera_from_world=se3.inverse(world_from_camera)))
    truth = world_from_camera @ pose()
    colors = [first_colors(box_model(), each, truth, REGION) for each in cameras]
    found = track(box_model(), cameras, colors, se3.plus(truth, np.array(STARTS[0])), CONFIG)
    assert error(found.world_from_object, truth)[0] < 1
    assert found.lines > 300


def test_an_object_of_which_nothing_is_seen_stays_where_it_was(rng: np.random.Generator) -> None:
    seen = sight(rng, pose())
    hidden = replace(seen, occluders=Occluders((constant_depth(0.2),)))
    for blind, start in ((hidden, pose()), (seen, se3.exp(np.array([0, 0, 0, 9.0, 0, 1])))):
        found = track(box_model(), [blind], [learnt(seen)], start, CONFIG)
        assert np.array_equal(found.world_from_object, start)
        assert found.lines == found.points == 0 and found.energy == 0 and not found.hessian.any()


def test_an_occluder_in_the_picture_does_not_drag_the_object_along(rng: np.random.Generator) -> None:
    # A bar the colour of the wall, 40 cm away, covers part of the box.
    seen = sight(rng, pose())
    image, bar = seen.image.copy(), np.zeros((480, 640), np.float32)
    bar[:, 360:380] = 0.4
    image[:, 360:380] = [60, 90, 180]
    covered = Sight(image, COLOR_CAMERA, np.eye(4), None, Occluders((DepthImage(bar, COLOR_CAMERA, np.eye(4)),)))
    found = track(box_model(), [covered], [learnt(seen)], se3.plus(pose(), np.array(STARTS[0])), CONFIG)
    assert error(found.world_from_object, pose())[0] < 4


def test_a_picture_without_texture_leaves_the_object_where_it_was() -> None:
    blank = Sight(np.full((480, 640, 3), 90, np.uint8), COLOR_CAMERA, np.eye(4))
    found = track(box_model(), [blank], [learnt(blank)], pose(), CONFIG)
    # Lines are drawn to their middle pixels, and a pixel is one millimetre.
    assert error(found.world_from_object, pose())[0] < 1


def test_colours_follow_what_the_camera_sees(rng: np.random.Generator) -> None:
    seen = sight(rng, pose())
    darker = replace(seen, image=(seen.image // 2))
    colors = learnt(seen)
    after = updated_colors(colors, box_model(), darker, pose(), REGION)
    dark_box = (100 >> 4) << 8 | (30 >> 4) << 4 | 20 >> 4
    assert colors.posterior[dark_box] == 0.5 < 0.9 < after.posterior[dark_box]


def test_a_sight_is_checked_when_it_is_made() -> None:
    with pytest.raises(ValueError, match=r"uint8 \(480, 640, 3\)"):
        Sight(np.zeros((480, 641, 3), np.uint8), COLOR_CAMERA, np.eye(4))
    with pytest.raises(ValueError, match="undistort"):
        Sight(np.zeros((2, 2, 3), np.uint8), Camera(np.eye(3), 2, 2, (0.1, 0.0, 0.0, 0.0)), np.eye(4))


def test_the_box_of_the_pictures_is_the_box_of_the_model(rng: np.random.Generator) -> None:
    picture = color_picture(rng, pose(), noise=0.0)
    red = picture[..., 0] > 100
    pixels = COLOR_CAMERA.project(se3.act(pose(), box_model().surface_point[0].astype(float))).round().astype(int)
    assert red[pixels[:, 1], pixels[:, 0]].mean() > 0.97
