from __future__ import annotations

import logging
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from multicam.bundle.viewpoints import cache
from multicam.bundle.viewpoints.cache import cache_folder, load_viewpoints
from multicam.bundle.viewpoints.generate import ViewpointConfig
from multicam.errors import DataError
from multicam.geometry.mesh import Mesh
from tests.bundle.viewpoints.shapes import box, moved, open_box

CONFIG = ViewpointConfig(subdivisions=1, contour_points=20, surface_points=10, picture=60)


def _files(folder: Path) -> list[Path]:
    return sorted((folder / "viewpoints").iterdir())


def test_a_model_is_generated_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = load_viewpoints({1: box(), 2: open_box()}, CONFIG, folder=tmp_path)
    assert len(_files(tmp_path)) == 2
    monkeypatch.setattr(cache, "generate", lambda *_: pytest.fail("generated again"))
    # Colours are no part of the shape.
    painted = replace(box(), colors=np.zeros((8, 3), np.uint8))
    second = load_viewpoints({"box": painted, "open box": open_box()}, CONFIG, folder=tmp_path)
    for field in fields(first[1]):
        np.testing.assert_array_equal(getattr(first[1], field.name), getattr(second["box"], field.name))


def test_another_mesh_configuration_or_format_is_another_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = box()
    load_viewpoints({1: mesh}, CONFIG, folder=tmp_path)
    load_viewpoints({1: moved(mesh, (0, 0, 1e-6))}, CONFIG, folder=tmp_path)
    load_viewpoints({1: Mesh(mesh.vertices, mesh.faces[::-1])}, CONFIG, folder=tmp_path)
    load_viewpoints({1: mesh}, replace(CONFIG, seed=1), folder=tmp_path)
    monkeypatch.setattr(cache, "FORMAT", cache.FORMAT + 1)
    load_viewpoints({1: mesh}, CONFIG, folder=tmp_path)
    assert len(_files(tmp_path)) == 5


def test_a_damaged_file_is_noticed_and_made_anew(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    load_viewpoints({1: box()}, CONFIG, folder=tmp_path)
    path = _files(tmp_path)[0]
    whole = path.read_bytes()
    path.write_bytes(whole[:1000])
    with caplog.at_level(logging.WARNING):
        load_viewpoints({1: box()}, CONFIG, folder=tmp_path)
    assert "is no viewpoint model" in caplog.text
    assert "generated anew" in caplog.text
    assert path.read_bytes() == whole


def test_a_cache_that_cannot_be_written_is_named_with_a_way_out(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="set MULTICAM_CACHE to another folder"):
        load_viewpoints({1: box()}, CONFIG, folder=tmp_path / "file")


def test_the_folder_follows_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MULTICAM_CACHE", str(tmp_path))
    assert cache_folder() == tmp_path
    load_viewpoints({1: box()}, CONFIG)
    assert len(_files(tmp_path)) == 1
    monkeypatch.delenv("MULTICAM_CACHE")
    assert cache_folder() == Path.home() / ".cache" / "multicam"
