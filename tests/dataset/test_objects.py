"""The catalogue: models folders there and back, and the traps of units."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from multicam.dataset.bop_writer import write_models
from multicam.dataset.objects import Catalogue, ObjectModel, load_catalogue
from multicam.geometry.symmetry import Symmetries
from tests.close import assert_close
from tests.faults import edit_json, sentence
from tests.toy_objects import BRACKET, PEG, PLATE, toy_meshes


@pytest.fixture
def models(tmp_path: Path, catalogue: Catalogue) -> Path:
    """A models folder of the toy objects."""
    write_models(tmp_path / "models", catalogue, toy_meshes())
    return tmp_path / "models"


def test_a_models_folder_comes_back_as_it_was_written(models: Path, catalogue: Catalogue) -> None:
    found = load_catalogue(models)
    assert found.obj_ids == catalogue.obj_ids
    for obj_id, written in catalogue.objects.items():
        read = found[obj_id]
        assert read.name == written.name
        assert read.diameter == pytest.approx(written.diameter, rel=1e-12)
        assert_close(read.box, written.box, atol=1e-12)
        assert_close(read.keypoints, written.keypoints, atol=1e-12)
        assert_close(read.symmetries.transforms(), written.symmetries.transforms(), atol=1e-12)
        assert_close(read.load_mesh().vertices, toy_meshes()[obj_id].vertices, atol=1e-7)


def test_files_are_in_millimetres(models: Path, catalogue: Catalogue) -> None:
    row = json.loads((models / "models_info.json").read_text())[str(PLATE)]
    assert row["diameter"] == pytest.approx(1000 * catalogue[PLATE].diameter)
    assert (row["min_x"], row["size_x"]) == pytest.approx((-60, 120))
    assert len(row["symmetries_discrete"]) == 3
    axis = json.loads((models / "models_info.json").read_text())[str(PEG)]["symmetries_continuous"][0]
    assert axis["offset"] == pytest.approx([12, -5, 0])
    points = json.loads((models / "keypoints.json").read_text())[str(PLATE)]
    assert np.abs(points).max() == pytest.approx(60, rel=0.05)
    assert np.abs(trimesh.load(models / "obj_000002.ply").vertices).max() == pytest.approx(60)


def test_the_root_of_a_data_set_will_do(models: Path) -> None:
    assert load_catalogue(models.parent).obj_ids == load_catalogue(models).obj_ids
    (models / "models_info.json").rename(models.parent / "models_info.json")
    (models / "keypoints.json").rename(models.parent / "keypoints.json")
    found = load_catalogue(models.parent)
    assert found[BRACKET].keypoints is not None
    assert found[BRACKET].mesh_path == models / "obj_000001.ply"


def test_classes_are_listed_by_number_not_by_text(models: Path) -> None:
    edit_json(models / "models_info.json", lambda info: info.update({"10": info.pop("2"), "21": info.pop("1")}))
    (models / "keypoints.json").unlink()
    assert load_catalogue(models).obj_ids == (3, 4, 5, 6, 10, 21)


def test_an_unknown_class_is_refused_with_the_known_ones(catalogue: Catalogue) -> None:
    assert 7 not in catalogue
    expected = "unknown object class 7; the catalogue holds 1 (bracket), 2 (plate), 3 (peg)"
    assert expected in sentence(lambda: catalogue[7])


def test_a_models_info_in_metres_is_refused(models: Path) -> None:
    def to_metres(info: Any) -> None:
        for row in info.values():
            for name in ("diameter", *(f"{a}_{b}" for a in ("min", "size") for b in "xyz")):
                row[name] /= 1000

    edit_json(models / "models_info.json", to_metres)
    text = sentence(lambda: load_catalogue(models))
    assert "object 1 (bracket) has a diameter of 0.1" in text
    assert "must be in millimetres (BOP format), is it in metres?" in text


def test_keypoints_in_metres_are_refused(models: Path) -> None:
    edit_json(models / "keypoints.json", lambda points: points.update({"2": [[0.06, 0.03, 0], [-0.06, -0.03, 0]]}))
    text = sentence(lambda: load_catalogue(models))
    assert "object 2 (plate) is 135.647 mm across but its keypoints 0.134164 mm" in text
    assert "millimetres" in text


def test_a_box_in_metres_is_refused(models: Path) -> None:
    def to_metres(info: Any) -> None:
        for b in "xyz":
            info["2"][f"size_{b}"] /= 1000

    edit_json(models / "models_info.json", to_metres)
    assert "its box 0.135647 mm" in sentence(lambda: load_catalogue(models))


def test_a_mesh_in_metres_where_millimetres_are_due_is_refused(models: Path) -> None:
    mesh = toy_meshes()[PLATE]
    trimesh.Trimesh(mesh.vertices, mesh.faces).export(models / "obj_000002.ply")
    text = sentence(load_catalogue(models)[PLATE].load_mesh)
    assert "obj_000002.ply is 0.1356 mm across but models_info.json says 135.6 mm" in text
    assert "another unit than millimetres?" in text


def test_a_glb_is_in_metres_as_its_format_says(models: Path) -> None:
    (models / "obj_000002.ply").unlink()
    mesh = toy_meshes()[PLATE]
    trimesh.Trimesh(mesh.vertices, mesh.faces).export(models / "obj_000002.glb")
    assert load_catalogue(models)[PLATE].load_mesh().diameter() == pytest.approx(0.1356, rel=1e-3)
    trimesh.Trimesh(1000 * mesh.vertices, mesh.faces).export(models / "obj_000002.glb")
    assert "another unit than metres?" in sentence(load_catalogue(models)[PLATE].load_mesh)


def test_a_missing_mesh_is_told_when_it_is_needed(models: Path) -> None:
    (models / "obj_000002.ply").unlink()
    catalogue = load_catalogue(models)
    assert "object 2 (plate) has no mesh file" in sentence(catalogue[PLATE].load_mesh)


@pytest.mark.parametrize(
    ("edit", "expected"),
    [
        (lambda info: info["2"].pop("diameter"), 'entry 2 does not follow the BOP format: "diameter" is missing'),
        (lambda info: info["2"].update(diameter="big"), "entry 2 does not follow the BOP format: could not convert"),
        (lambda info: info["2"].update(diameter=float("nan")), "has a diameter of nan mm"),
        (lambda info: info["2"].pop("size_z"), '"size_z" is missing'),
        (lambda info: info.update({"2": 3}), "entry 2 does not follow the BOP format: expected an object, got 3"),
        (lambda info: info.update(plate=info.pop("2")), "entry plate does not follow the BOP format"),
        (lambda info: info["2"].update(symmetries_discrete=[[1.0] * 15]), "entry 2 does not follow"),
        (lambda info: info["2"].update(symmetries_discrete=[[0.0] * 16]), "not orthonormal"),
        (lambda info: info["2"].update(symmetries_discrete=[np.diag([1.0, 1, -1, 1]).ravel().tolist()]), "mirrors"),
        (lambda info: info["2"].update(symmetries_continuous=[{"axis": [0, 0, 0]}]), "must not be zero"),
        (lambda info: info["2"].update(symmetries_continuous=[{"offset": [0, 0, 0]}]), '"axis" is missing'),
        (lambda info: info.clear(), "must map class ids to objects"),
    ],
)
def test_faulty_entries_are_refused_by_name(models: Path, edit: Callable[[Any], None], expected: str) -> None:
    edit_json(models / "models_info.json", edit)
    (models / "keypoints.json").unlink()
    assert expected in sentence(lambda: load_catalogue(models))


@pytest.mark.parametrize("name", ["models_info.json", "keypoints.json"])
def test_malformed_json_is_refused(models: Path, name: str) -> None:
    (models / name).write_text('{"1": [')
    assert f"{name} is not valid JSON: Expecting value at line 1, column 8" in sentence(lambda: load_catalogue(models))
    (models / name).write_text("[1]")
    assert "must map class ids" in sentence(lambda: load_catalogue(models))


def test_keypoints_of_unknown_classes_are_refused(models: Path) -> None:
    edit_json(models / "keypoints.json", lambda points: points.update({"77": [[1, 2, 3]]}))
    assert "keypoints.json names unknown classes ['77']" in sentence(lambda: load_catalogue(models))


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    assert "models folder" in sentence(lambda: load_catalogue(tmp_path / "absent"))
    assert "models_info.json does not exist" in sentence(lambda: load_catalogue(tmp_path))


def test_box_corners_span_the_box_or_a_cube_of_the_diameter(catalogue: Catalogue) -> None:
    corners = catalogue[PLATE].box_corners()
    assert len(np.unique(corners, axis=0)) == 8
    assert_close(np.abs(corners), np.tile([0.06, 0.03, 0.01], (8, 1)))
    cube = ObjectModel(1, "cube", 0.3, Symmetries()).box_corners()
    assert np.linalg.norm(cube[:, None] - cube, axis=-1).max() == pytest.approx(0.3)


def test_published_models_folders_are_read(bench_dir: Path) -> None:
    ycbv = load_catalogue(bench_dir / "ycbv")
    assert len(ycbv.obj_ids) == 21
    assert ycbv[1].load_mesh().diameter() == pytest.approx(ycbv[1].diameter, rel=0.01)
    assert len(load_catalogue(bench_dir / "tless").obj_ids) == 30
    lmo = load_catalogue(bench_dir / "lmo")
    assert lmo[lmo.obj_ids[0]].load_mesh().colors is not None
