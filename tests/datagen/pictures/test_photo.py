"""From linear light to the picture a camera stores."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from datagen.pictures.photo import develop
from datagen.scenes.spec import Lens, Shot
from multicam.geometry.camera import Camera

SHOT = Shot(Camera(np.array([[50.0, 0, 31.5], [0, 50, 23.5], [0, 0, 1]]), 64, 48), np.eye(4))
GREY = np.full((48, 64, 3), 0.3, np.float32)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_a_perfect_picture_of_grey_is_grey_whatever_its_brightness() -> None:
    first, second = develop(GREY, SHOT, rng()), develop(7 * GREY, SHOT, rng())
    assert np.array_equal(first, second)
    assert np.ptp(first) == 0
    assert 100 < first[0, 0, 0] < 140


def test_corners_get_darker_by_the_vignette() -> None:
    picture = develop(GREY, replace(SHOT, lens=Lens(vignette=0.4)), rng()).astype(float)
    # In linear light the corner keeps 0.6 of the middle.
    linear = (picture[..., 0] / 255) ** 2.2
    assert linear[0, 0] / linear[24, 32] == pytest.approx(0.6, abs=0.05)
    assert linear[24, 0] / linear[24, 32] == pytest.approx(0.8, abs=0.05)


def test_softness_is_the_standard_deviation_of_the_blur() -> None:
    point = np.zeros((48, 64, 3), np.float32)
    point[24, 32] = 1
    from datagen.pictures.photo import _through_lens

    row = _through_lens(point, Lens(softness=0.7))[24, :, 0]
    x = np.arange(64) - 32
    assert np.sqrt(np.sum(row * x**2) / row.sum()) == pytest.approx(0.7, abs=0.05)


def test_white_balance_tints_the_picture() -> None:
    warm = develop(GREY, replace(SHOT, white=(1.2, 1.0, 0.8)), rng())[0, 0].astype(int)
    assert warm[0] > warm[1] + 5 > warm[2] + 10
