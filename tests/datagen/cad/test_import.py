"""Foreign CAD with one YAML to a BOP models folder, and the mistakes that people make in it."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold
from PIL import Image

from datagen.cad.importer import import_parts
from datagen.cad.parts import read_parts
from datagen.cli import main
from datagen.commands.import_parts import import_folder
from multicam.dataset.objects import load_catalogue
from multicam.errors import ConfigError, DataError
from multicam.files import read_json, write_json
from multicam.geometry.mesh import Mesh, save_ply
from multicam.progress import SilentProgress
from tests.datagen.cad.shapes import mesh_of

WEDGE = np.array([[0, 0, 0], [0.06, 0, 0], [0, 0.04, 0], [0, 0, 0.03], [0.05, 0, 0.01]])


def brick() -> Mesh:
    return mesh_of(Manifold.cube((60, 40, 20), True))


def export(mesh: Mesh, path: Path, units_per_metre: float = 1000.0) -> None:
    trimesh.Trimesh(mesh.vertices * units_per_metre, mesh.faces, process=False).export(path)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four files of four kinds: an STL soup, an OBJ with a picture, a coloured PLY with gaps, a GLB in metres."""
    cad = tmp_path / "cad"
    cad.mkdir()
    export(brick(), cad / "brick.stl")
    Image.new("RGB", (8, 8), (200, 30, 30)).save(cad / "skin.png")
    (cad / "panel.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    rows = [f"v {1000 * x} {1000 * y} {1000 * z}" for x, y, z in WEDGE]
    # The last face is a line, and the last vertex of no face.
    faces = ["f 1/1 2/2 3/3", "f 1/1 3/3 4/1", "f 1/1 4/2 2/3", "f 2/1 4/2 3/3", "f 1/1 2/2 1/1"]
    text = ["mtllib panel.mtl", *rows, "vt 0 0", "vt 1 0", "vt 1 1", "usemtl skin", *faces]
    (cad / "panel.obj").write_text("\n".join(text) + "\n")
    open_shell = Mesh(WEDGE, np.array([[0, 1, 2], [0, 4, 3]]), np.full((5, 3), 90, dtype=np.uint8))
    save_ply(open_shell, cad / "obj_000007.ply", 1000.0)
    export(brick(), cad / "housing.glb", 1.0)
    (cad / "parts.yaml").write_text(
        "unit: mm\nparts:\n  - {file: brick.stl}\n  - {file: panel.obj, name: front panel, symmetries: none}\n"
        "  - {file: obj_000007.ply}\n  - {file: housing.glb, unit: m, symmetries: [{axis: [0, 0, 2], fold: 2}]}\n"
    )
    return cad


def run(folder: Path, output: Path, replace: bool = False) -> tuple:
    return import_parts(folder / "parts.yaml", output, 8, 0, SilentProgress(), replace)


def test_a_folder_of_foreign_cad_becomes_bop_models(folder: Path, tmp_path: Path) -> None:
    rows = run(folder, tmp_path / "models")
    catalogue = load_catalogue(tmp_path / "models")
    assert catalogue.obj_ids == (1, 2, 4, 7)
    assert [catalogue[i].name for i in catalogue.obj_ids] == ["brick", "front panel", "housing", "obj_000007"]
    stl, panel, glb, shell = (catalogue[i].load_mesh() for i in catalogue.obj_ids)
    assert stl.diameter() == pytest.approx(brick().diameter(), rel=1e-5)
    assert len(stl.vertices) == 8, "an STL repeats its vertices; they are put together again"
    assert glb.diameter() == pytest.approx(brick().diameter(), rel=1e-5)
    assert panel.texture == tmp_path / "models" / "obj_000002.png"
    assert len(panel.faces) == 4
    assert shell.colors is not None
    assert all(catalogue[i].keypoints is not None for i in catalogue.obj_ids)
    by_id = {row.obj_id: row for row in rows}
    assert (by_id[1].symmetry, by_id[1].proposed) == ("180° about x, y, z", True)
    assert (by_id[2].symmetry, by_id[2].proposed) == ("none", False)
    assert (by_id[4].symmetry, by_id[4].proposed) == ("180° about z", False)
    assert [by_id[i].watertight for i in (1, 2, 4, 7)] == [True, True, True, False]
    assert by_id[1].size_mm == pytest.approx((60, 40, 20))
    assert len(catalogue[4].symmetries.discrete) == 1


def test_the_table_and_what_to_write_are_logged(folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO):
        main(["import", "--parts", str(folder), "--output", str(tmp_path / "models")])
    assert "60.0 * 40.0 * 20.0" in caplog.text
    assert "180° about x, y, z  the shape" in caplog.text
    assert "brick.stl: symmetries: [{axis: [1, 0, 0], fold: 2}, {axis: [0, 1, 0], fold: 2}]" in caplog.text
    assert "Symmetries of 2 of 4 parts were proposed" in caplog.text


def test_what_is_to_be_written_means_what_was_proposed(folder: Path, tmp_path: Path) -> None:
    first = run(folder, tmp_path / "a")
    statement = next(row.statement for row in first if row.obj_id == 1)
    parts = folder / "parts.yaml"
    parts.write_text(parts.read_text().replace("{file: brick.stl}", f"{{file: brick.stl, {statement}}}"))
    run(folder, tmp_path / "b")
    a, b = (load_catalogue(tmp_path / name)[1].symmetries.transforms() for name in "ab")
    assert np.abs(a[:, None] - b).max(axis=(-2, -1)).min(axis=1).max() < 1e-9


def test_an_import_is_made_once_and_refused_when_the_parts_change(folder: Path, tmp_path: Path) -> None:
    models = tmp_path / "models"
    first = run(folder, models)
    times = {p: p.stat().st_mtime_ns for p in models.iterdir()}
    assert run(folder, models) == first
    assert {p: p.stat().st_mtime_ns for p in models.iterdir()} == times
    Image.new("RGB", (8, 8), (0, 30, 30)).save(folder / "skin.png")
    with pytest.raises(DataError, match=r"holds other models than .*parts\.yaml now describes.*--replace"):
        run(folder, models)
    run(folder, models, replace=True)
    assert run(folder, models)


def test_models_from_elsewhere_are_not_overwritten(folder: Path, tmp_path: Path) -> None:
    write_json(tmp_path / "models" / "models_info.json", {"1": {"diameter": 100}})
    with pytest.raises(DataError, match="holds other models"):
        run(folder, tmp_path / "models")


def test_a_folder_to_render_is_imported_into_the_output(folder: Path, tmp_path: Path) -> None:
    models = import_folder(folder, tmp_path / "out", SilentProgress())
    assert models == tmp_path / "out" / "models"
    assert import_folder(folder, tmp_path / "out", SilentProgress()) == models
    # A BOP models folder is taken as it is.
    assert import_folder(models, tmp_path / "other", SilentProgress()) == models
    assert not (tmp_path / "other").exists()


def test_mounted_groups_are_passed_on_if_they_are_of_these_parts(folder: Path, tmp_path: Path) -> None:
    group = {"name": "pair", "parts": [{"obj_id": 1, "R_group_from_object": [1, 0, 0, 0, 1, 0, 0, 0, 1]}]}
    write_json(folder / "groups.json", [group])
    parts = folder / "parts.yaml"
    parts.write_text("assemblies: groups.json\n" + parts.read_text())
    run(folder, tmp_path / "models")
    assert read_json(tmp_path / "models" / "assemblies.json") == [group]
    group["parts"][0]["obj_id"] = 3
    write_json(folder / "groups.json", [group])
    with pytest.raises(DataError, match=r"mounts obj_id 3, but .* has \[1, 2, 4, 7\]"):
        run(folder, tmp_path / "other")


@pytest.mark.parametrize("text", ["", "parts:\n  - file: brick.stl\n", "unit:\n"])
def test_a_missing_unit_is_refused_with_what_it_would_mean(folder: Path, text: str) -> None:
    (folder / "parts.yaml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_parts(folder / "parts.yaml")
    said = str(caught.value)
    assert "does not state the unit" in said
    assert "brick.stl would be 74.8 mm if in mm, 748 mm if in cm, 74.8 m if in m, 1.9 m if in inch" in said
    assert "plausible: mm or cm or inch" in said


@pytest.mark.parametrize(
    ("unit", "scale", "words"),
    [
        ("mm", 1.0, r"0\.0748 mm across in mm.*probably m \(74\.8 mm\)"),
        ("m", 1000.0, r"74\.8 m across in m.*probably mm \(74\.8 mm\)"),
        ("mm", 1000 / 25.4, r"2\.95 mm across in mm.*probably inch \(74\.8 mm\)"),
    ],
)
def test_a_wrong_unit_is_refused_with_the_likely_one(tmp_path: Path, unit: str, scale: float, words: str) -> None:
    export(brick(), tmp_path / "brick.stl", scale)
    (tmp_path / "parts.yaml").write_text(f"unit: {unit}\n")
    with pytest.raises(DataError, match=words):
        run(tmp_path, tmp_path / "models")
    assert not (tmp_path / "models").exists()


def test_mixed_units_are_refused_naming_both(tmp_path: Path) -> None:
    small = brick()
    export(Mesh(small.vertices * 0.1, small.faces), tmp_path / "bolt.stl")
    export(Mesh(small.vertices * 38, small.faces), tmp_path / "rack.stl")
    (tmp_path / "parts.yaml").write_text("unit: mm\n")
    with pytest.raises(DataError, match=r"bolt\.stl is 7\.48 mm across and rack\.stl 2\.84 m, 380 times"):
        run(tmp_path, tmp_path / "models")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("unit: furlong\n", r"expected one of mm, cm, m, inch, got 'furlong'"),
        ("unit: mm\nparts: [{file: brik.stl}]\n", r'names brik\.stl \(did you mean "brick\.stl"\?\), but .* holds'),
        ("unit: mm\nparts: [{file: skin.png}]\n", r"names skin\.png, which is no mesh"),
        ("unit: mm\nparts: [{file: ../x.stl}]\n", r"within .*, relative to it"),
        ("unit: mm\nparts: [{file: brick.stl, symetries: none}]\n", r'unknown key "parts\[0\]\.symetries"'),
        ("unit: mm\nparts: [{file: brick.stl}, {file: panel.obj, obj_id: 1}]\n", "both have the obj_id 1"),
        ("unit: mm\nparts: [{file: brick.stl, obj_id: 0}]\n", "begin with 1"),
        ("unit: mm\nparts: [{file: brick.stl, symmetries: [{axis: [0, 0, 1]}]}]\n", "either `fold`"),
        ("unit: mm\nparts: [{file: brick.stl, symmetries: [{axis: [0, 0, 0], fold: 2}]}]\n", "not zero"),
    ],
)
def test_mistakes_in_parts_yaml_are_told_in_one_sentence(folder: Path, text: str, words: str) -> None:
    (folder / "parts.yaml").write_text(text)
    with pytest.raises((ConfigError, DataError), match=words):
        read_parts(folder / "parts.yaml")


def test_axes_that_do_not_fit_together_are_refused(folder: Path, tmp_path: Path) -> None:
    axes = "[{axis: [0, 0, 1], fold: 5}, {axis: [1, 0, 0], fold: 3}]"
    (folder / "parts.yaml").write_text(f"unit: mm\nparts: [{{file: brick.stl, symmetries: {axes}}}]\n")
    with pytest.raises(ConfigError, match="do not fit together"):
        run(folder, tmp_path / "models")


def test_without_parts_yaml_it_is_said_what_to_write(folder: Path) -> None:
    (folder / "parts.yaml").unlink()
    with pytest.raises(ConfigError, match=r"`unit: mm` for example.*--suggest.*brick\.stl, housing\.glb, obj_000007"):
        read_parts(folder / "parts.yaml")


def test_a_draft_lacks_the_unit_and_nothing_else(folder: Path, tmp_path: Path) -> None:
    parts = folder / "parts.yaml"
    parts.unlink()
    main(["import", "--parts", str(folder), "--suggest"])
    with pytest.raises(ConfigError, match="does not state the unit"):
        read_parts(parts)
    with pytest.raises(ConfigError, match="is there already"):
        main(["import", "--parts", str(folder), "--suggest"])
    text = parts.read_text()
    assert "# 74.8 mm if in mm, 748 mm if in cm, 74.8 m if in m, 1.9 m if in inch" in text
    assert "obj_id: 7" in text
    parts.write_text(text.replace("unit:", "unit: mm").replace("name: housing", "name: housing\n    unit: m"))
    assert len(run(folder, tmp_path / "models")) == 4


def test_the_example_in_the_documentation_is_read(tmp_path: Path) -> None:
    text = (Path(__file__).parents[3] / "docs" / "datagen.md").read_text()
    (tmp_path / "parts.yaml").write_text(text.partition("```yaml\n")[2].partition("```")[0])
    for name in ("bracket.stl", "obj_000005.ply", "knob.glb", "bottle.obj"):
        (tmp_path / name).touch()
    config = read_parts(tmp_path / "parts.yaml")
    assert [p.obj_id for p in config.parts] == [1, 5, 12, 4]
    knob, bottle = (part.stated(config.unit) for part in config.parts[2:])
    assert knob is not None
    assert len(knob.discrete) == 11
    assert bottle is not None
    assert bottle.axes[0].offset == pytest.approx([0.0125, 0, 0])


def test_a_unit_alone_takes_every_mesh(folder: Path) -> None:
    (folder / "parts.yaml").write_text("unit: cm\n")
    config = read_parts(folder / "parts.yaml")
    assert [(p.file, p.obj_id) for p in config.parts] == [
        ("brick.stl", 1), ("housing.glb", 2), ("obj_000007.ply", 7), ("panel.obj", 4),
    ]  # fmt: skip
