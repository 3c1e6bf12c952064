"""The nine instruments: sound meshes, true symmetries, parts that fit together, files that read back."""

from __future__ import annotations

import itertools
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from manifold3d import Error, Manifold
from numpy.typing import NDArray
from scipy.spatial import KDTree

from datagen.instruments.assemblies import ASSEMBLIES, Assembly
from datagen.instruments.catalogue import HANDLE, INSTRUMENTS, NAIL, Instrument, instrument, mesh, solid
from datagen.instruments.command import main
from datagen.instruments.nail import bowed
from datagen.instruments.shapes import block, frame, ridged, rod
from datagen.instruments.write import write_models
from multicam.dataset.objects import load_catalogue
from multicam.errors import ConfigError
from multicam.geometry import se3, so3

MM = 1e-3
NEAREST = 24
SYMMETRIC = {"bar", "gear", "roller", "screw", "stick"}
SORTED_SIZES_MM = {
    "aiming_arm": ((30, 50), (30, 50), (220, 250)),
    "bar": ((4, 10), (12, 25), (150, 200)),
    "gear": ((12, 25), (40, 50), (40, 50)),
    "insertion_handle": ((25, 60), (100, 140), (180, 215)),
    "nail": ((10, 16), (15, 40), (300, 400)),
    "roller": ((20, 40), (20, 40), (80, 100)),
    "screw": ((5, 10), (5, 10), (60, 70)),
    "spacer": ((20, 40), (20, 40), (30, 45)),
    "stick": ((8, 16), (8, 16), (240, 260)),
}

every_instrument = pytest.mark.parametrize("part", INSTRUMENTS, ids=lambda part: part.name)
every_assembly = pytest.mark.parametrize("assembly", ASSEMBLIES, ids=lambda assembly: assembly.name)


@cache
def fine_triangles(name: str) -> tuple[NDArray[np.float64], KDTree]:
    """Corners (F, 3, 3) of a part's surface cut into triangles of about 2 mm, and a tree of their middles."""
    fine = solid(name).refine_to_length(2 * MM).to_mesh64()
    corners = fine.vert_properties[:, :3][fine.tri_verts]
    return corners, KDTree(corners.mean(1))


def surface_distance(name: str, transform: NDArray[np.float64], samples: int = 600) -> float:
    """Greatest distance (both ways) between a part and its transformed self, metres, over surface samples.

    Turning the samples forwards and backwards covers both ways with one tree. Each sample is measured to the
    NEAREST triangles by their middles: never too near, and too far by less than a triangle's edge.
    """
    points = mesh(name).sample_surface(samples, np.random.default_rng(1))
    both = np.concatenate([se3.act(transform, points), se3.act(se3.inverse(transform), points)])
    corners, middles = fine_triangles(name)
    _, nearest = middles.query(both, k=NEAREST)
    queries = np.repeat(both, NEAREST, axis=0)
    # In millimetres, because trimesh's tolerances are absolute and blur small triangles in metres.
    feet = trimesh.triangles.closest_point(corners[nearest.reshape(-1)] / MM, queries / MM) * MM
    return float(np.linalg.norm(feet - queries, axis=1).reshape(-1, NEAREST).min(1).max())


def turn(axis: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    return se3.from_parts(so3.exp(axis * angle), np.zeros(3))


def test_the_set_has_the_nine_classes_in_their_order() -> None:
    assert [part.obj_id for part in INSTRUMENTS] == list(range(1, 10))
    assert [part.name for part in INSTRUMENTS] == sorted(SORTED_SIZES_MM)
    assert {part.name for part in INSTRUMENTS if part.symmetries} == SYMMETRIC


@every_instrument
def test_a_mesh_is_one_watertight_piece_with_outward_normals(part: Instrument) -> None:
    shape = mesh(part.name)
    surface = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
    assert solid(part.name).status() == Error.NoError
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.volume == pytest.approx(solid(part.name).volume(), rel=1e-6)
    assert surface.volume > 0
    assert surface.body_count == 1
    assert 2000 <= len(shape.faces) <= 8000


@every_instrument
def test_a_part_has_the_size_of_the_real_instrument(part: Instrument) -> None:
    low, high = mesh(part.name).box
    for size, (least, most) in zip(sorted((high - low) / MM), SORTED_SIZES_MM[part.name], strict=True):
        assert least <= size <= most


@every_instrument
def test_the_origin_is_the_middle_of_the_box(part: Instrument) -> None:
    np.testing.assert_allclose(mesh(part.name).box.mean(0), 0, atol=1e-8)


@every_instrument
def test_drawing_a_part_again_gives_the_same_triangles(part: Instrument) -> None:
    first, second = part.draw().to_mesh64(), part.draw().to_mesh64()
    assert first.vert_properties.tobytes() == second.vert_properties.tobytes()
    assert first.tri_verts.tobytes() == second.tri_verts.tobytes()


@every_instrument
def test_declared_symmetries_map_the_surface_to_itself(part: Instrument) -> None:
    turns = [turn for axis in part.symmetries.axes for turn in axis.rotation(np.linspace(0.05, 6.2, 7))]
    for transform in (*part.symmetries.discrete, *turns):
        assert surface_distance(part.name, transform) < 0.1 * MM


def test_declared_discrete_symmetries_with_the_identity_are_a_group() -> None:
    for part in INSTRUMENTS:
        members = part.symmetries.transforms(steps=12)
        products = np.einsum("aij,bjk->abik", members, members).reshape(-1, 1, 4, 4)
        assert np.all(np.abs(products - members).max((-1, -2)).min(-1) < 1e-9), part.name


@every_instrument
def test_half_turns_that_are_not_declared_change_the_part_clearly(part: Instrument) -> None:
    spread = mesh(part.name).sample_surface(4000, np.random.default_rng(2))
    principal = np.linalg.eigh(np.cov(spread.T))[1].T
    known = part.symmetries.transforms(steps=2)
    for axis in (*np.eye(3), *principal):
        half_turn = turn(axis, np.pi)
        lateral_to_an_axis = any(abs(a.direction @ axis) < 1e-6 for a in part.symmetries.axes)
        declared = np.abs(known - half_turn).max((-1, -2)).min() < 1e-2
        if not declared and (not part.symmetries or lateral_to_an_axis):
            assert surface_distance(part.name, half_turn) > (3.0 if not part.symmetries else 1.0) * MM


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_an_asymmetric_part_has_no_rotation_about_a_coordinate_axis(count: int) -> None:
    for part in INSTRUMENTS:
        if part.name not in SYMMETRIC:
            for axis in np.eye(3):
                assert surface_distance(part.name, turn(axis, 2 * np.pi / count), 300) > 3 * MM


def test_the_gear_has_no_finer_symmetry_than_its_lightening_holes() -> None:
    assert surface_distance("gear", turn(np.array([0.0, 0.0, 1.0]), np.pi / 6)) > 2 * MM
    assert surface_distance("gear", turn(np.array([0.0, 0.0, 1.0]), 2 * np.pi / 18)) > 2 * MM


def mounted(assembly: Assembly) -> list[Manifold]:
    return [solid(mount.name).transform(mount.group_from_object[:3]) for mount in assembly.mounts]


@every_assembly
def test_mounted_parts_do_not_run_through_each_other(assembly: Assembly) -> None:
    for (i, one), (j, other) in itertools.combinations(enumerate(mounted(assembly)), 2):
        common_mm3 = (one ^ other).volume() / MM**3
        assert common_mm3 < 0.1, f"{assembly.mounts[i].name} and {assembly.mounts[j].name}"


@every_assembly
def test_every_mounted_part_touches_the_rest(assembly: Assembly) -> None:
    parts = mounted(assembly)
    reached, waiting = [parts[0]], parts[1:]
    while waiting:
        touching = [p for p in waiting if any(p.min_gap(q, 1 * MM) < 0.2 * MM for q in reached)]
        assert touching, f"{len(waiting)} parts of {assembly.name} hang in the air"
        reached += touching
        waiting = [p for p in waiting if p not in touching]


def test_the_oblique_guide_holes_aim_at_the_oblique_holes_of_the_nail() -> None:
    arm, nail_solid = instrument("aiming_arm").draw(), instrument("nail").draw()
    for z in NAIL.recon_heights:
        direction = np.array([-np.sin(NAIL.recon_angle), 0.0, -np.cos(NAIL.recon_angle)])
        wire = rod(0.002, -0.2, 0.2).transform(frame((0.0, 0.0, z), tuple(direction))[:3])
        assert (wire ^ arm).volume() == pytest.approx(0, abs=1e-15)
        assert (wire ^ nail_solid).volume() == pytest.approx(0, abs=1e-15)


def test_the_bow_leaves_the_proximal_part_straight_and_keeps_lengths() -> None:
    axis = np.column_stack([np.zeros(200), np.zeros(200), np.linspace(0, -NAIL.length, 200)])
    bent = bowed(axis, NAIL)
    straight = axis[:, 2] >= -NAIL.proximal_length
    np.testing.assert_array_equal(bent[straight], axis[straight])
    lengths = np.linalg.norm(np.diff(bent, axis=0), axis=1)
    np.testing.assert_allclose(lengths.sum(), NAIL.length, rtol=1e-5)
    assert bent[-1, 1] < -0.015


def test_the_nail_is_seated_on_the_keyed_connector() -> None:
    turned_wrongly = instrument("nail").draw().rotate((0, 0, 180))
    assert (instrument("insertion_handle").draw() ^ turned_wrongly).volume() > 1e-9
    assert HANDLE.key_clearance > 0


def test_a_chamfered_block_has_the_volume_of_its_drawing() -> None:
    # A unit cube loses a prism c^2/2 by 1 - 2c along each of its 12 edges, and 5/6 of a small cube of side c at
    # each of its 8 corners (all below the plane x + y + z = 2c through the ends of the three chamfers).
    c = 0.1
    assert block((0, 0, 0), (1, 1, 1), c).volume() == pytest.approx(1 - 6 * c**2 * (1 - 2 * c) - 8 * 5 / 6 * c**3)


def test_ridges_stay_between_root_and_crest_and_rise() -> None:
    points = np.array(ridged(1.0, 2.0, 0.0, 10.0, 5))
    assert np.all(np.diff(points[:, 1]) >= 0)
    assert set(points[:, 0]) == {1.0, 2.0}
    assert np.sum(points[:, 0] == 2.0) == 10


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("set") / "models"
    main(["--output", str(folder)])
    return folder


def test_the_written_folder_reads_back_as_a_catalogue(models: Path) -> None:
    catalogue = load_catalogue(models)
    assert catalogue.obj_ids == tuple(range(1, 10))
    for part in INSTRUMENTS:
        model = catalogue[part.obj_id]
        assert model.name == part.name
        assert len(model.symmetries.axes) == len(part.symmetries.axes)
        np.testing.assert_allclose(model.symmetries.discrete, part.symmetries.discrete, atol=1e-9)
        np.testing.assert_allclose(model.load_mesh().vertices, mesh(part.name).vertices, atol=1e-7)
        assert model.keypoints is not None
        assert model.keypoints.shape == (8, 3)
        # Keypoints lie on the surface, hence inside the box, and are spread over the part.
        assert np.all(np.abs(model.keypoints) <= mesh(part.name).box[1] + 1e-9)
        assert np.ptp(model.keypoints, axis=0).max() > 0.7 * model.diameter


def test_assemblies_are_written_in_millimetres(models: Path) -> None:
    rows = json.loads((models / "assemblies.json").read_text())
    assert [row["name"] for row in rows] == [a.name for a in ASSEMBLIES]
    for row, assembly in zip(rows, ASSEMBLIES, strict=True):
        for part, mount in zip(row["parts"], assembly.mounts, strict=True):
            assert part["obj_id"] == instrument(part["name"]).obj_id
            expected = mount.group_from_object
            np.testing.assert_allclose(np.reshape(part["R_group_from_object"], (3, 3)), expected[:3, :3])
            np.testing.assert_allclose(part["t_group_from_object"], expected[:3, 3] * 1000)


def test_writing_again_gives_the_same_bytes(models: Path, tmp_path: Path) -> None:
    write_models(tmp_path, keypoints=8, seed=0)
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (models / path.name).read_bytes(), path.name


def test_the_seed_changes_keypoints_only(models: Path, tmp_path: Path) -> None:
    write_models(tmp_path, keypoints=8, seed=1)
    changed = {path.name for path in tmp_path.iterdir() if path.read_bytes() != (models / path.name).read_bytes()}
    assert changed == {"keypoints.json"}


@pytest.mark.parametrize("flags", [["--keypoints", "3"], ["--seed", "-1"], ["--samples", "0"]])
def test_options_that_make_no_sense_are_refused_in_one_sentence(flags: list[str], tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"is -?\d+"):
        main(["--output", str(tmp_path / "models"), *flags])
    assert not (tmp_path / "models").exists()
