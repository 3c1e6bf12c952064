from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from multicam.bundle.viewpoints.shell import Shell, find_shells
from multicam.geometry.mesh import Mesh
from tests.bundle.viewpoints.shapes import BOX, box, joined, moved, open_box, torus


def _volume(shell: Shell) -> float:
    a, b, c = np.moveaxis(shell.vertices[shell.faces], 1, 0)
    return float(np.sum(a * np.cross(b, c)) / 6)


@given(seed=st.integers(0, 1000))
def test_a_closed_mesh_faces_outward_however_its_faces_wound(seed: int) -> None:
    mesh, rng = box(), np.random.default_rng(seed)
    turned = np.where(rng.random((len(mesh.faces), 1)) < 0.5, mesh.faces[:, ::-1], mesh.faces)
    shell = find_shells(Mesh(mesh.vertices, rng.permutation(turned)))
    assert shell.closed == 12
    np.testing.assert_allclose(_volume(shell), np.prod(BOX))


def test_seams_do_not_open_a_mesh() -> None:
    mesh = torus()
    torn = Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(mesh.faces.size).reshape(-1, 3))
    shell = find_shells(torn)
    assert shell.closed == len(mesh.faces)
    assert len(shell.vertices) == len(mesh.vertices)


def test_an_open_mesh_and_one_with_a_single_side_have_no_closed_shell() -> None:
    assert find_shells(open_box()).closed == 0
    # The projective plane of six vertices: each edge ties two faces, yet it has but one side.
    plane = "012 023 034 045 051 124 235 341 452 513"
    faces = np.array([[int(corner) for corner in face] for face in plane.split()])
    vertices = np.random.default_rng(0).normal(size=(6, 3))
    shell = find_shells(Mesh(vertices, faces))
    assert shell.closed == 0
    assert len(shell.faces) == 10


def test_each_shell_of_a_mesh_is_judged_for_itself() -> None:
    inside_out = Mesh(moved(box(), (1, 0, 0)).vertices, box().faces[:, ::-1])
    mesh = joined(open_box(), box((1, 1, 1)), inside_out)
    shell = find_shells(mesh)
    assert shell.closed == 24
    assert len(shell.faces) == len(mesh.faces)
    np.testing.assert_allclose(_volume(Shell(shell.vertices, shell.faces[:24], 24)), 1 + np.prod(BOX))


def test_boxes_that_touch_along_an_edge_stay_closed() -> None:
    one = box((1, 1, 1))
    shell = find_shells(joined(one, moved(one, (1, 1, 0))))
    assert shell.closed == 24
    np.testing.assert_allclose(_volume(shell), 2)


def test_collapsed_triangles_and_unused_vertices_are_left_out() -> None:
    mesh = box()
    shell = find_shells(Mesh(np.vstack((mesh.vertices, [[9, 9, 9]])), np.vstack((mesh.faces, [[0, 0, 1]]))))
    assert shell.closed == len(shell.faces) == 12
    assert len(shell.vertices) == 8
    np.testing.assert_allclose(np.linalg.norm(shell.normals(), axis=1), 1)
