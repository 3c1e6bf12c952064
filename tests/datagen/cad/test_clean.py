"""Foreign meshes put right without changing their shape."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from manifold3d import Manifold

from datagen.cad.clean import cleaned, is_watertight
from multicam.errors import DataError
from multicam.geometry.mesh import Mesh
from tests.close import assert_close
from tests.datagen.cad.shapes import mesh_of
from tests.strategies import seeds

BRICK = mesh_of(Manifold.cube((60, 40, 20), True))
FILE = Path("part.stl")


def areas(mesh: Mesh) -> np.ndarray:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


@given(seeds())
def test_a_soup_with_rubbish_in_it_is_the_same_surface(rng: np.random.Generator) -> None:
    """Repeated vertices, unused ones, faces that are lines and points: all go, and nothing else."""
    soup = BRICK.vertices[BRICK.faces].reshape(-1, 3)
    rubbish = rng.uniform(-1, 1, size=(5, 3))
    line = [[len(soup), len(soup), 0], [0, 1, 0], [3, 3, 3]]
    faces = np.concatenate((np.arange(len(soup)).reshape(-1, 3), line))
    order = rng.permutation(len(faces))
    made = cleaned(Mesh(np.concatenate((soup, rubbish)), faces[order]), FILE)
    assert (len(made.vertices), len(made.faces)) == (8, 12)
    assert areas(made).sum() == pytest.approx(areas(BRICK).sum())
    assert_close(made.box, BRICK.box)
    assert is_watertight(made)


def test_vertices_of_different_colours_stay_apart_and_are_no_gap() -> None:
    soup = BRICK.vertices[BRICK.faces].reshape(-1, 3)
    colors = np.repeat(np.arange(12, dtype=np.uint8)[:, None] * 20, 3, axis=0) * np.ones(3, dtype=np.uint8)
    made = cleaned(Mesh(soup, np.arange(36).reshape(-1, 3), colors), FILE)
    assert len(made.vertices) == 36
    assert made.colors is not None
    assert np.array_equal(made.colors[made.faces], colors.reshape(-1, 3, 3))
    assert is_watertight(made)


def test_a_solid_that_is_inside_out_is_turned() -> None:
    made = cleaned(Mesh(BRICK.vertices, BRICK.faces[:, ::-1]), FILE)
    outward = np.cross(*(made.vertices[made.faces[:, k]] - made.vertices[made.faces[:, 0]] for k in (1, 2)))
    assert np.all((outward * made.vertices[made.faces].mean(1)).sum(1) > 0)


def test_an_open_shell_stays_as_it_is() -> None:
    shell = Mesh(BRICK.vertices, BRICK.faces[:-1, ::-1])
    assert not is_watertight(shell)
    made = cleaned(shell, FILE)
    assert_close(made.vertices[made.faces], shell.vertices[shell.faces])


def test_bodies_apart_stay_apart() -> None:
    both = Mesh(np.concatenate((BRICK.vertices, BRICK.vertices + 0.1)), np.concatenate((BRICK.faces, BRICK.faces + 8)))
    made = cleaned(both, FILE)
    assert (len(made.vertices), len(made.faces)) == (16, 24)


def test_a_mesh_of_lines_is_refused() -> None:
    with pytest.raises(DataError, match=r"part\.stl holds 1 triangles, and all of them are without area"):
        cleaned(Mesh(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]]), np.array([[0, 1, 2]])), FILE)
