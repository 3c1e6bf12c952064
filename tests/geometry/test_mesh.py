"""Meshes: size, surface samples, keypoints, and files in several formats and units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import pdist
from scipy.stats import kstest

from multicam.errors import DataError
from multicam.geometry.keypoints import farthest_points, sample_keypoints
from multicam.geometry.mesh import Mesh, load_mesh, save_ply
from tests.close import assert_close
from tests.strategies import seeds
from tests.toy_objects import BRACKET, PLATE, ROD, toy_meshes


@pytest.mark.parametrize("obj_id", toy_meshes())
def test_diameter_is_the_greatest_distance_of_two_vertices(obj_id: int) -> None:
    mesh = toy_meshes()[obj_id]
    assert mesh.diameter() == pytest.approx(pdist(mesh.vertices).max())


def test_a_flat_mesh_has_a_diameter_too() -> None:
    card = Mesh(np.array([[0, 0, 0], [0.3, 0, 0], [0.3, 0.4, 0], [0, 0.4, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    assert card.diameter() == pytest.approx(0.5)


def test_box_spans_the_vertices() -> None:
    assert_close(toy_meshes()[PLATE].box, [[-0.06, -0.03, -0.01], [0.06, 0.03, 0.01]])


def test_surface_samples_are_uniform(rng: np.random.Generator) -> None:
    """A tall thin triangle beside a large one: area decides, and each triangle is filled evenly."""
    vertices = np.array([[0, 0, 0], [3, 0, 0], [0, 1, 0], [0, 0, 1.0], [0, 1, 1], [0, 0, 2]])
    mesh = Mesh(vertices, np.array([[0, 1, 2], [3, 4, 5]]))
    points = mesh.sample_surface(20_000, rng)
    on_first = points[:, 2] == 0
    assert on_first.mean() == pytest.approx(1.5 / 2.0, abs=0.015)
    x, y = points[on_first, 0] / 3, points[on_first, 1]
    assert (x + y).max() <= 1 + 1e-12
    # In a triangle the distance from one side has the density 2 (1 - x), for each of the three sides.
    for distance in (x, y, 1 - x - y):
        assert kstest(distance, lambda d: 1 - (1 - np.clip(d, 0, 1)) ** 2).pvalue > 0.01


@given(seeds(), st.integers(1, 12))
def test_farthest_points_spread_greedily(rng: np.random.Generator, count: int) -> None:
    points = rng.normal(size=(60, 3))
    chosen = farthest_points(points, count)
    assert len(chosen) == count
    assert len(np.unique(chosen, axis=0)) == count
    centroid = np.linalg.norm(points - points.mean(0), axis=1)
    assert np.linalg.norm(chosen[0] - points.mean(0)) == pytest.approx(centroid.max())
    for k in range(1, count):
        gap = np.linalg.norm(points[:, None] - chosen[:k], axis=-1).min(axis=1)
        assert np.linalg.norm(chosen[k] - chosen[:k], axis=-1).min() == pytest.approx(gap.max())


def test_farthest_points_of_too_few_are_refused() -> None:
    with pytest.raises(ValueError, match="8 keypoints asked of 5 points"):
        farthest_points(np.zeros((5, 3)), 8)


def test_keypoints_lie_on_the_surface_and_reach_its_ends(rng: np.random.Generator) -> None:
    mesh = toy_meshes()[PLATE]
    keypoints = sample_keypoints(mesh, 8, rng)
    assert np.abs(keypoints / [0.06, 0.03, 0.01]).max(axis=1) == pytest.approx(1)
    assert pdist(keypoints).max() > 0.95 * mesh.diameter()


def test_ply_comes_back_in_metres(tmp_path: Path) -> None:
    mesh = toy_meshes()[ROD]
    colored = Mesh(mesh.vertices, mesh.faces, np.full((len(mesh.vertices), 3), (10, 200, 30), dtype=np.uint8))
    save_ply(colored, tmp_path / "rod.ply", 1000.0)
    back = load_mesh(tmp_path / "rod.ply", 0.001)
    assert_close(back.vertices, mesh.vertices, atol=1e-7)
    assert np.array_equal(back.faces, mesh.faces)
    assert back.colors is not None
    assert np.array_equal(back.colors[0], [10, 200, 30])
    assert [p.name for p in tmp_path.iterdir()] == ["rod.ply"]


@pytest.mark.parametrize("suffix", ["obj", "stl", "glb", "off", "ply"])
def test_other_formats_are_read_in_the_unit_that_was_stated(tmp_path: Path, suffix: str) -> None:
    mesh = toy_meshes()[BRACKET]
    path = tmp_path / f"bracket.{suffix}"
    trimesh.Trimesh(mesh.vertices * 1000, mesh.faces, process=False).export(path)
    assert load_mesh(path, 0.001).diameter() == pytest.approx(mesh.diameter(), rel=1e-5)
    assert load_mesh(path, 1.0).diameter() == pytest.approx(1000 * mesh.diameter(), rel=1e-5)


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "glb", "off"])
@pytest.mark.parametrize("content", [b"", b"this is not a mesh\n", bytes(range(256)) * 3])
def test_rubbish_is_refused_in_one_sentence(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"broken.{suffix}"
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"broken\.\w+ (cannot be read|holds no triangles)"):
        load_mesh(path, 0.001)


@pytest.mark.parametrize("suffix", ["ply", "stl", "glb"])
@pytest.mark.parametrize("share", [0.3, 0.7, 0.97])
def test_a_truncated_mesh_is_refused(tmp_path: Path, suffix: str, share: float) -> None:
    mesh = toy_meshes()[ROD]
    path = tmp_path / f"cut.{suffix}"
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(DataError, match=r"cut\.\w+ (cannot be read|holds no triangles)"):
        load_mesh(path, 0.001)


def test_a_point_cloud_and_a_missing_file_are_refused(tmp_path: Path) -> None:
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "points.ply")
    with pytest.raises(DataError, match="no triangles"):
        load_mesh(tmp_path / "points.ply", 1.0)
    with pytest.raises(DataError, match=r"mesh file .*absent\.ply does not exist"):
        load_mesh(tmp_path / "absent.ply", 1.0)


@pytest.mark.parametrize(
    ("vertices", "faces"),
    [
        (np.zeros((3, 2)), np.array([[0, 1, 2]])),
        (np.full((3, 3), np.nan), np.array([[0, 1, 2]])),
        (np.eye(3), np.zeros((0, 3), dtype=np.int64)),
        (np.eye(3), np.array([[0, 1, 3]])),
        (np.eye(3), np.array([[0, 1, -1]])),
    ],
)
def test_arrays_that_are_no_mesh_are_refused(vertices: np.ndarray, faces: np.ndarray) -> None:
    with pytest.raises(ValueError, match="mesh"):
        Mesh(vertices, faces)
