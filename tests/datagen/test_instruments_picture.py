"""The catalogue picture: every part in full view, on the floor, and a file that opens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from datagen.instruments.catalogue import INSTRUMENTS, Instrument, mesh
from datagen.instruments.command import main
from datagen.instruments.picture import studio
from multicam.geometry import se3


@pytest.mark.parametrize("part", INSTRUMENTS, ids=lambda part: part.name)
def test_a_part_fills_its_photograph_and_stays_inside(part: Instrument) -> None:
    scene = studio(part)
    (placed,), (shot,) = scene.objects, scene.shots
    in_world = se3.act(placed.world_from_object, mesh(part.name).vertices)
    pixels = shot.camera.project(se3.act(se3.inverse(shot.world_from_camera), in_world))
    size = np.array([shot.camera.width, shot.camera.height])
    assert in_world[:, 2].min() > 0
    assert np.all(pixels > 0)
    assert np.all(pixels < size - 1)
    assert (np.ptp(pixels, axis=0) / size).max() > 0.75


@pytest.mark.blender
@pytest.mark.slow
def test_the_picture_command_writes_a_small_png(tmp_path: Path) -> None:
    picture = tmp_path / "set.png"
    main(["--output", str(tmp_path / "models"), "--picture", str(picture), "--samples", "1"])
    with Image.open(picture) as opened:
        assert opened.format == "PNG"
        assert min(opened.size) > 600
        assert np.asarray(opened.convert("RGB")).std() > 20
    assert picture.stat().st_size < 400_000
