"""How pictures are taken."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from datagen.config import CameraConfig, DatagenConfig, RandomizationConfig
from datagen.scenes.looks import blackbody
from datagen.scenes.sample import sample_scene
from datagen.scenes.spec import Lens, Shot, scene_to_plain
from datagen.scenes.stock import Stock
from multicam.geometry import se3

CONFIG = DatagenConfig(images=300, images_per_scene=100)


@pytest.fixture(scope="module")
def shots(stock: Stock) -> tuple[Shot, ...]:
    return tuple(shot for index in range(3) for shot in sample_scene(CONFIG, stock, index).shots)


def test_pictures_move_by_no_more_than_was_asked_for(stock: Stock) -> None:
    config = replace(CONFIG, camera=CameraConfig(moving_fraction=1.0, motion=0.02))
    scene = sample_scene(config, stock, 0)
    centres = np.stack([o.world_from_object[:3, 3] for o in scene.objects])
    moved: list[float] = []
    for shot in scene.shots:
        assert shot.motion is not None
        depth = float(np.median(np.linalg.norm(centres - shot.world_from_camera[:3, 3], axis=1)))
        point = shot.world_from_camera @ np.array([0, 0, depth, 1])
        first, last = (
            shot.camera.project(
                (se3.inverse(se3.plus(shot.world_from_camera, side * shot.motion.twist / 2)) @ point)[:3]
            )
            for side in (-1, 1)
        )
        moved.append(float(np.linalg.norm(last - first)) / shot.camera.width)
    assert max(moved) < 0.0205
    assert np.mean(moved) > 0.004


def test_blur_and_patches_come_in_the_shares_asked_for(shots: tuple[Shot, ...]) -> None:
    count = len(shots)
    moving = [shot.motion for shot in shots if shot.motion is not None]
    assert abs(len(moving) / count - CONFIG.camera.moving_fraction) < 0.09
    assert abs(np.mean([m.row_share < 1 for m in moving]) - CONFIG.camera.rolling_fraction) < 0.2
    assert abs(np.mean([shot.lens.f_number > 0 for shot in shots]) - CONFIG.camera.focused_fraction) < 0.1
    assert abs(np.mean([bool(shot.overlays) for shot in shots]) - 1 / 3) < 0.1


def test_lenses_focus_on_an_object_and_err_by_a_tenth(stock: Stock) -> None:
    scene = sample_scene(replace(CONFIG, camera=CameraConfig(focused_fraction=1.0)), stock, 0)
    centres = np.stack([o.world_from_object[:3, 3] for o in scene.objects])
    errors = []
    for shot in scene.shots:
        depths = se3.act(se3.inverse(shot.world_from_camera), centres)[:, 2]
        errors.append(np.min(np.abs(np.log(shot.lens.focus / depths[depths > 0.1]))))
        assert CONFIG.camera.f_number[0] <= shot.lens.f_number <= CONFIG.camera.f_number[1]
    assert 0 < np.mean(errors) < 0.1


SWITCHES = {
    "exposure": {"exposure", "noise", "white"},
    "lens": {"lens"},
    "motion": {"motion"},
    "overlays": {"overlays"},
    "compression": {"jpeg"},
}


@pytest.mark.parametrize("kind", SWITCHES)
def test_switching_one_error_off_leaves_the_others_alone(stock: Stock, kind: str) -> None:
    on = scene_to_plain(sample_scene(CONFIG, stock, 0))
    off = scene_to_plain(sample_scene(replace(CONFIG, randomize=RandomizationConfig(**{kind: False})), stock, 0))
    assert [key for key in on if on[key] != off[key]] == ["shots"]
    changed = {key for a, b in zip(on["shots"], off["shots"], strict=True) for key in a if a[key] != b[key]}
    assert changed == SWITCHES[kind]


def test_without_any_error_a_shot_is_a_perfect_one(stock: Stock) -> None:
    nothing = RandomizationConfig(**{f.name: False for f in fields(RandomizationConfig)})
    (shot, *_) = sample_scene(replace(CONFIG, randomize=nothing), stock, 0).shots
    assert (shot.exposure, shot.noise, shot.lens, shot.motion, shot.overlays, shot.white, shot.jpeg) == (
        0.0, 0.0, Lens(), None, (), (1.0, 1.0, 1.0), 95,
    )  # fmt: skip


def test_black_bodies_go_from_red_to_blue() -> None:
    red, green, blue = blackbody(2500)
    assert red == pytest.approx(1)
    assert red > green > blue
    assert blackbody(9000)[2] == pytest.approx(1)
    # Daylight of 6500 K is nearly the white of sRGB.
    assert np.ptp(blackbody(6500)) < 0.09
    ratio = [blackbody(k)[0] / blackbody(k)[2] for k in np.linspace(2500, 9000, 40)]
    assert np.all(np.diff(ratio) < 0)


def test_windows_lie_all_over_the_image_and_see_what_the_camera_looks_at(stock: Stock) -> None:
    camera = CameraConfig(window=0.5, focal=(1.0, 1.0), off_centre=0.0, roll_deg=0.0)
    scene = sample_scene(replace(CONFIG, camera=camera), stock, 0)
    centres = np.stack([o.world_from_object[:3, 3] for o in scene.objects])
    principal = np.stack([shot.camera.matrix[:2, 2] for shot in scene.shots])
    # The image is 640 x 480; its middle may lie half a window beside the picture, and the lens 2 % beside the middle.
    assert all(shot.camera.matrix[0, 0] == 640 for shot in scene.shots)
    low, high = principal.min(axis=0), principal.max(axis=0)
    assert (low > (-0.5 - 13, -0.5 - 10)).all() and (low < (32, 24)).all()
    assert (high < (319.5 + 13, 239.5 + 10)).all() and (high > (288, 216)).all()
    for shot in scene.shots:
        seen = shot.camera.project(se3.act(se3.inverse(shot.world_from_camera), centres))
        assert np.abs(seen - (159.5, 119.5)).max(axis=1).min() < 1e-6


def test_a_window_leaves_the_opening_of_the_lens_as_it_is(stock: Stock) -> None:
    cameras = [CameraConfig(window=window, f_number=(2.0, 2.0), focused_fraction=1.0) for window in (1.0, 0.5)]
    whole, window = (sample_scene(replace(CONFIG, camera=camera), stock, 0).shots[0].lens for camera in cameras)
    assert (whole.f_number, window.f_number) == (2.0, 4.0)
