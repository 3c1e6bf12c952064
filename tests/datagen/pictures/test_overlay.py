"""Patches before the camera."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from datagen.pictures.overlay import overlaid
from datagen.pictures.renderer import Passes
from datagen.scenes.spec import Overlay

SQUARE = np.array([[4.0, 2], [7, 2], [7, 5], [4, 5]])
"""Pixels 4 to 7 of rows 2 to 5."""


def passes() -> Passes:
    shape = (8, 10)
    color = np.full((*shape, 3), 2.0, np.float32)
    return Passes(color, np.full(shape, 0.7, np.float32), np.ones(shape, np.uint16), np.ones(shape, np.float32))


def test_without_patches_nothing_changes() -> None:
    before = passes()
    assert overlaid(before, ()) is before


def test_a_patch_hides_what_is_behind_it() -> None:
    before = passes()
    after = overlaid(before, (Overlay(SQUARE, (0.5, 0.25, 0.0)),))
    inside = np.zeros((8, 10), bool)
    inside[2:6, 4:8] = True
    assert np.allclose(after.color[inside], [1.0, 0.5, 0.0])
    assert np.all(after.depth[inside] < 0.1)
    assert not after.index[inside].any()
    assert not after.alpha[inside].any()
    for name in ("color", "depth", "index", "alpha"):
        assert np.array_equal(getattr(after, name)[~inside], getattr(before, name)[~inside])
        assert np.array_equal(getattr(before, name), getattr(passes(), name))


def test_a_patch_beside_the_picture_hides_nothing(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "p.png"), np.full((4, 4, 3), 255, np.uint8))
    after = overlaid(
        passes(), (Overlay(SQUARE + 50, (0, 0, 0)), Overlay(SQUARE - 50, (0, 0, 0), str(tmp_path / "p.png")))
    )
    assert np.array_equal(after.color, passes().color)


def test_a_picture_is_stretched_over_its_patch(tmp_path: Path) -> None:
    picture = np.zeros((2, 2, 3), np.uint8)
    picture[0, 0] = (0, 0, 255)
    cv2.imwrite(str(tmp_path / "p.png"), picture)
    after = overlaid(passes(), (Overlay(SQUARE, (1, 1, 1), str(tmp_path / "p.png")),))
    assert np.allclose(after.color[2, 4], [2, 0, 0])
    assert np.allclose(after.color[5, 7], 0)
