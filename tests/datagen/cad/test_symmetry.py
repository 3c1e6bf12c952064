"""Proposed symmetries against shapes that have them, however they stand and are cut into triangles."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from manifold3d import Manifold

from datagen.cad.surface import Surface
from datagen.cad.symmetry import MOST_OF_DIAMETER, measure, propose
from datagen.cad.turns import turn
from multicam.dataset.objects import load_catalogue
from multicam.geometry import se3, so3
from multicam.geometry.mesh import Mesh, load_mesh
from multicam.geometry.symmetry import Symmetries
from tests.datagen.cad.shapes import CASES, X, Z, carried, key_way, mesh_of, moved, prism, retriangulated
from tests.strategies import Array, seeds, transforms
from tests.toy_objects import toy_meshes, toy_symmetries


def assert_alike(found: Symmetries, expected: Symmetries, mesh: Mesh) -> None:
    """Both sets hold the same symmetries, within 1.5 degrees and 1 % of the object's size."""
    assert len(found.axes) == len(expected.axes)
    assert len(found.discrete) == len(expected.discrete)
    diameter, middle = mesh.diameter(), mesh.vertices.mean(0)
    for ours, theirs in zip(found.axes, expected.axes, strict=True):
        assert abs(ours.direction @ theirs.direction) > np.cos(np.deg2rad(1.5))
        gap = ours.offset - theirs.offset
        assert np.linalg.norm(gap - ours.direction * (ours.direction @ gap)) < 0.01 * diameter
    if expected.axes:
        # Any half turn across the axis is as good as another.
        for transform in found.discrete:
            flipped = transform[:3, :3] @ expected.axes[0].direction
            assert flipped @ expected.axes[0].direction < -np.cos(np.deg2rad(3))
        return
    for wanted in expected.discrete:
        angles = np.linalg.norm(so3.log(np.swapaxes(found.discrete[:, :3, :3], 1, 2) @ wanted[:3, :3]), axis=1)
        best = int(angles.argmin())
        assert angles[best] < np.deg2rad(1.5)
        assert np.linalg.norm(se3.act(found.discrete[best], middle) - se3.act(wanted, middle)) < 0.02 * diameter


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
@settings(max_examples=2, phases=(Phase.explicit, Phase.generate))
@given(pose=transforms(reach=0.2), rng=seeds(), splits=st.integers(0, 40))
def test_the_symmetries_of_simple_solids_are_found(
    name: str, pose: Array, rng: np.random.Generator, splits: int
) -> None:
    mesh, expected = CASES[name]
    turned = moved(retriangulated(mesh, rng, splits), pose)
    found = propose(turned)
    assert_alike(found.symmetries, carried(expected, pose), turned)
    assert found.deviation < 0.01 * turned.diameter()


@pytest.mark.parametrize("obj_id", toy_meshes())
def test_the_toys_have_the_symmetries_that_they_are_listed_with(obj_id: int) -> None:
    mesh = toy_meshes()[obj_id]
    assert_alike(propose(mesh).symmetries, toy_symmetries()[obj_id], mesh)


def test_axes_of_the_objects_own_frame_come_as_clean_numbers() -> None:
    mesh = mesh_of(Manifold.cube((60, 40, 20), True))
    found = propose(mesh).symmetries.discrete
    assert {tuple(np.diag(m)) for m in found} == {(1, -1, -1, 1), (-1, 1, -1, 1), (-1, -1, 1, 1)}
    assert all(np.array_equal(m, np.diag(np.diag(m))) for m in found)


def test_the_group_is_closed() -> None:
    found = propose(CASES["hexagonal prism"][0]).symmetries.transforms()
    assert len(found) == 12
    products = (found[:, None] @ found[None]).reshape(-1, 4, 4)
    assert np.abs(products[:, None] - found).max(axis=(-2, -1)).min(axis=1).max() < 1e-6


def test_a_small_notch_makes_a_shaft_one_of_its_own() -> None:
    """And what lies between: a slot in the middle leaves the half turn about the slot, two leave three half turns."""
    slot = Manifold.cube((5, 8, 20), True)
    middle = mesh_of(prism(20, 60, 64) - slot.translate((0, 20, 0)))
    found = propose(middle).symmetries
    assert not found.axes
    assert_alike(found, Symmetries(turn(np.array([0, 1.0, 0]), np.zeros(3), np.pi)[None]), middle)
    both = propose(mesh_of(prism(20, 60, 64) - slot.translate((0, 20, 0)) - slot.translate((0, -20, 0)))).symmetries
    assert not both.axes
    assert len(both.discrete) == 3


def test_a_ball_may_be_turned_any_way() -> None:
    assert len(propose(mesh_of(Manifold.sphere(30, 48))).symmetries.axes) == 3


@pytest.mark.parametrize(("sides", "round_"), [(8, False), (16, True)])
def test_coarse_cylinders_are_round_and_octagons_are_not(sides: int, round_: bool) -> None:
    found = propose(mesh_of(prism(20, 60, sides))).symmetries
    assert bool(found.axes) == round_
    assert len(found.discrete) == (1 if round_ else 15)


def scanned(noise: float) -> Mesh:
    """A fine box of three different edges, each vertex off by noise of a standard deviation in diameters."""
    made = trimesh.creation.box((0.12, 0.08, 0.05)).subdivide_to_size(0.004)
    diameter = float(np.linalg.norm((0.12, 0.08, 0.05)))
    rng = np.random.default_rng(3)
    points = made.vertices + rng.normal(size=made.vertices.shape) * noise * diameter
    return Mesh(np.asarray(points), np.asarray(made.faces, dtype=np.int64))


def test_noise_of_a_hand_held_scan_is_borne() -> None:
    """The 95 % quantile is what the tolerance was derived from: at most 2.8 standard deviations."""
    mesh = scanned(0.008)
    found = propose(mesh)
    assert len(found.symmetries.discrete) == 3
    assert 1.0 < found.deviation / (0.008 * mesh.diameter()) < 2.8
    assert found.deviation < MOST_OF_DIAMETER * mesh.diameter()


def test_the_nearest_miss_is_reported() -> None:
    """A box with edges of 60 and 63 mm is not square, but nearly."""
    mesh = mesh_of(Manifold.cube((60, 63, 20), True))
    found = propose(mesh)
    assert len(found.symmetries.discrete) == 3
    assert found.nearest is not None
    near, deviation = found.nearest
    # A quarter turn, or half a turn about a diagonal of the nearly square side.
    assert (near.fold, round(abs(float(near.direction @ Z)))) in ((4, 1), (2, 0))
    assert 0.001 < deviation < 0.01


def test_stated_symmetries_are_measured() -> None:
    mesh = mesh_of(Manifold.cube((60, 40, 20), True))
    half, quarter = turn(Z, np.zeros(3), np.pi), turn(Z, np.zeros(3), np.pi / 2)
    assert measure(mesh, Symmetries(half[None])).deviation < 1e-6
    assert 0.008 < measure(mesh, Symmetries(quarter[None])).deviation < 0.0105
    assert measure(mesh, Symmetries()).deviation == 0


def test_a_proposal_is_the_same_each_time() -> None:
    mesh = mesh_of(key_way())
    a, b = propose(mesh), propose(mesh)
    assert a.deviation == b.deviation
    assert np.array_equal(a.symmetries.discrete, b.symmetries.discrete)


def test_moments_of_a_surface_are_exact() -> None:
    """A box of edges a, b, c, by hand: x^2 over its six sides."""
    a, b, c = 0.06, 0.04, 0.02
    surface = Surface(mesh_of(Manifold.cube((60, 40, 20)).translate((10, 0, 0))), 100)
    area = 2 * (a * b + b * c + c * a)
    along_x = (2 * b * c * (a / 2) ** 2 + 2 * (a * b + a * c) * a * a / 12) / area
    assert surface.moments[2] == pytest.approx(along_x, rel=1e-6)
    assert abs(surface.directions[2] @ X) == pytest.approx(1)
    assert surface.centre == pytest.approx([0.04, 0.02, 0.01])


def test_proposals_agree_with_the_published_ones_of_lmo(bench_dir: Path) -> None:
    """Egg box and glue: half a turn about z; the six others none."""
    info = json.loads((bench_dir / "lmo" / "models_info.json").read_text())
    catalogue = load_catalogue(bench_dir / "lmo")
    assert len(catalogue.obj_ids) == 8
    for obj_id in catalogue.obj_ids:
        model = catalogue[obj_id]
        assert model.mesh_path is not None
        found = propose(load_mesh(model.mesh_path, 0.001)).symmetries
        assert bool(found) == ("symmetries_discrete" in info[str(obj_id)]), model.name
        assert np.array_equal(found.discrete, model.symmetries.discrete.round(9)), model.name
        assert found.axes == ()
