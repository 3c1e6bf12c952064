"""Our models beside those that M3T made of the same bottle (162 views of 10 points from 40 cm)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from multicam.bundle.viewpoints.generate import ViewpointConfig, generate
from multicam.bundle.viewpoints.model import ViewpointModel
from multicam.geometry.mesh import Mesh, load_mesh
from tests.bundle.m3t_files import M3tModel, read_model

CONFIG = ViewpointConfig(subdivisions=2, distance=0.4, contour_points=1000, surface_points=1000, offsets=26)
PIXEL = 0.00043
"""Metres that a pixel of M3T's pictures spans."""


@pytest.fixture(scope="module")
def oracle(bench_dir: Path) -> Path:
    return bench_dir / "m3t_oracle"


@pytest.fixture(scope="module")
def ours(oracle: Path) -> ViewpointModel:
    mesh = load_mesh(oracle / "_body" / "schauma.obj", 1.0)
    body_from_mesh = read_model(oracle / "model_test" / "region_model.bin").body["columns"].T
    return generate(Mesh(mesh.vertices + body_from_mesh[:3, 3], mesh.faces), CONFIG)


@pytest.fixture(scope="module")
def region(oracle: Path) -> M3tModel:
    return read_model(oracle / "model_test" / "region_model.bin")


@pytest.fixture(scope="module")
def depth(oracle: Path) -> M3tModel:
    return read_model(oracle / "model_test" / "depth_model.bin")


def _same_views(ours: ViewpointModel, theirs: M3tModel) -> np.ndarray:
    """Our view for each of theirs."""
    cosine = theirs.direction @ ours.direction.T
    assert cosine.max(axis=1).min() > 1 - 1e-6
    return cosine.argmax(axis=1)


def _nearest(points: np.ndarray, theirs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (V, n) from each of their points (V, n, 3) to the nearest of ours (V, N, 3), and which that is."""
    apart = np.linalg.norm(theirs[:, :, None] - points[:, None], axis=3)
    return apart.min(axis=2), apart.argmin(axis=2)


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    cosine = np.sum(a * b, axis=-1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def test_contours_agree(ours: ViewpointModel, region: M3tModel) -> None:
    view = _same_views(ours, region)
    ratio = ours.contour_length[view] / region.measure
    assert ratio.mean() == pytest.approx(1, abs=0.003)
    assert np.abs(ratio - 1).max() < 0.01
    apart, nearest = _nearest(ours.contour_point[view], region.points["point"])
    # Our points stand about 0.5 mm apart; depth is uncertain where the surface turns away.
    assert np.median(apart) < 2 * PIXEL
    assert np.quantile(apart, 0.99) < 0.01
    at = (np.arange(len(view))[:, None], nearest)
    normals = _angle(ours.contour_normal[view][at], region.points["normal"])
    assert np.median(normals) < 4
    assert np.quantile(normals, 0.95) < 12
    assert np.isinf(ours.background).all() == (region.points["background"] > 1e30).all()
    difference = ours.foreground[view][at] - region.points["foreground"]
    # They measure between centres of pixels, we between borders.
    assert np.median(difference) == pytest.approx(PIXEL, abs=PIXEL / 2)


def test_surfaces_agree(ours: ViewpointModel, depth: M3tModel) -> None:
    view = _same_views(ours, depth)
    ratio = ours.surface_area[view] / depth.measure
    assert ratio.mean() == pytest.approx(1, abs=0.002)
    assert np.abs(ratio - 1).max() < 0.005
    apart, nearest = _nearest(ours.surface_point[view], depth.points["point"])
    assert np.median(apart) < 0.002
    at = (np.arange(len(view))[:, None], nearest)
    assert np.median(_angle(ours.surface_normal[view][at], depth.points["normal"])) < 5


def test_depth_offsets_agree(ours: ViewpointModel, region: M3tModel, depth: M3tModel) -> None:
    view = _same_views(ours, region)
    _, at_contour = _nearest(ours.contour_point[view], region.points["point"])
    _, at_surface = _nearest(ours.surface_point[view], depth.points["point"])
    rows = np.arange(len(view))[:, None]
    for mine, theirs in (
        (ours.contour_offset[view][rows, at_contour], region.points["offset"][:, :, : CONFIG.offsets]),
        (ours.surface_offset[view][rows, at_surface], depth.points["offset"][:, :, : CONFIG.offsets]),
    ):
        # M3T looks at one pixel in a step of the radius; we at all of them, and so find nearer ones.
        difference = np.mean(mine - theirs, axis=(0, 1))[2:]
        assert np.all(difference > -2e-4)
        assert np.all(difference < 0.1 * theirs.mean(axis=(0, 1))[2:] + 2e-4)
