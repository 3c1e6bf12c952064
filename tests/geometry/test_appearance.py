"""Colours and pictures of meshes survive files of every form."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from multicam.dataset.bop_writer import write_models
from multicam.dataset.objects import Catalogue, load_catalogue
from multicam.errors import DataError
from multicam.geometry.mesh import Mesh, load_mesh, save_ply
from tests.close import assert_close
from tests.toy_objects import PLATE, toy_catalogue, toy_meshes

SQUARE = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])
RED, GREEN, BLUE, YELLOW = (255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 0)


def picture(path: Path) -> Path:
    """Red above green on the left, blue above yellow on the right."""
    tiles = np.array([[RED, BLUE], [GREEN, YELLOW]], dtype=np.uint8)
    Image.fromarray(np.kron(tiles, np.ones((16, 16, 1), dtype=np.uint8))).save(path)
    return path


def color_at(mesh: Mesh, uv: np.ndarray) -> tuple[int, ...]:
    """What a mesh shows at a point of its picture."""
    assert mesh.texture is not None
    pixels = np.asarray(Image.open(mesh.texture).convert("RGB"))
    height, width = pixels.shape[:2]
    row, column = int((1 - uv[1]) * (height - 1) + 0.5), int(uv[0] * (width - 1) + 0.5)
    return tuple(int(v) for v in pixels[row, column])


def corners(mesh: Mesh) -> np.ndarray:
    """(F, 3, 5) place and texture coordinates of every corner of every face: the same however vertices are split."""
    assert mesh.uv is not None
    return np.concatenate((mesh.vertices, mesh.uv), axis=1)[mesh.faces]


@pytest.fixture
def textured(tmp_path: Path) -> Mesh:
    """A square with a seam: one of its corners lies in two places of the picture."""
    uv = np.array([[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9], [0.1, 0.6]])
    vertices = np.concatenate((SQUARE, SQUARE[:1]))
    faces = np.array([[0, 1, 2], [4, 2, 3]])
    return Mesh(vertices, faces, uv=uv, texture=picture(tmp_path / "source.png"))


def test_a_textured_ply_comes_back_with_its_picture_beside_it(textured: Mesh, tmp_path: Path) -> None:
    path = tmp_path / "out" / "obj_000003.ply"
    save_ply(textured, path, 1000.0)
    header = path.read_bytes().partition(b"end_header")[0]
    assert b"comment TextureFile obj_000003.png\n" in header
    assert b"property float texture_u\nproperty float texture_v\n" in header
    back = load_mesh(path, 0.001)
    assert back.texture == tmp_path / "out" / "obj_000003.png"
    assert textured.texture is not None
    assert back.texture.read_bytes() == textured.texture.read_bytes()
    assert_close(corners(back), corners(textured), atol=1e-7)
    # Written over itself it stays the same.
    save_ply(back, path, 1000.0)
    assert_close(corners(load_mesh(path, 0.001)), corners(textured), atol=1e-7)


def test_a_jpeg_becomes_a_png(textured: Mesh, tmp_path: Path) -> None:
    assert textured.texture is not None
    Image.open(textured.texture).save(tmp_path / "photo.jpg", quality=95)
    mesh = Mesh(textured.vertices, textured.faces, uv=textured.uv, texture=tmp_path / "photo.jpg")
    save_ply(mesh, tmp_path / "a.ply", 1.0)
    assert Image.open(tmp_path / "a.png").format == "PNG"
    assert np.abs(np.subtract(color_at(load_mesh(tmp_path / "a.ply", 1.0), np.array([0.2, 0.9])), RED)).max() < 12


def test_a_published_textured_ply_is_read(tmp_path: Path) -> None:
    """BOP's own form: normals between place and texture coordinates, and the name of the picture in a comment."""
    picture(tmp_path / "obj_000001.png")
    rows = "\n".join(
        f"{x * 1000} {y * 1000} 0 0 0 1 {u} {v}" for (x, y, _), (u, v) in zip(SQUARE, SQUARE[:, :2] * 10, strict=True)
    )
    (tmp_path / "obj_000001.ply").write_text(
        "ply\nformat ascii 1.0\ncomment TextureFile obj_000001.png\nelement vertex 4\n"
        + "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "texture_u", "texture_v"))
        + f"element face 2\nproperty list uchar int vertex_indices\nend_header\n{rows}\n3 0 1 2\n3 0 2 3\n"
    )
    mesh = load_mesh(tmp_path / "obj_000001.ply", 0.001)
    assert mesh.texture == tmp_path / "obj_000001.png"
    expected = np.concatenate((SQUARE, SQUARE[:, :2] * 10), axis=1)[TRIANGLES]
    assert_close(corners(mesh), expected, atol=1e-7)


def write_obj(folder: Path, material: str) -> Path:
    """The square with a seam as OBJ, whose texture coordinates belong to corners of faces, not to vertices."""
    (folder / "square.mtl").write_text(material)
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in SQUARE)
    coordinates = "".join(f"vt {u} {v}\n" for u, v in [(0.1, 0.1), (0.9, 0.1), (0.9, 0.9), (0.1, 0.9), (0.1, 0.6)])
    path = folder / "square.obj"
    path.write_text(f"mtllib square.mtl\n{vertices}{coordinates}usemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 1/5 3/3 4/4\n")
    return path


def test_an_obj_keeps_its_picture_and_its_seams(textured: Mesh, tmp_path: Path) -> None:
    picture(tmp_path / "skin.png")
    path = write_obj(tmp_path, "newmtl a\nmap_Kd skin.png\n")
    path.write_text(path.read_text().replace("usemtl b\n", ""))
    mesh = load_mesh(path, 1.0)
    assert mesh.texture == tmp_path / "skin.png"
    assert len(mesh.vertices) == 5
    assert_close(corners(mesh), corners(textured), atol=1e-7)


def test_materials_without_pictures_become_colours_of_vertices(tmp_path: Path) -> None:
    mesh = load_mesh(write_obj(tmp_path, "newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 0 1\n"), 1.0)
    assert mesh.texture is None
    assert mesh.colors is not None
    assert np.array_equal(mesh.colors[mesh.faces], np.repeat([[RED], [BLUE]], 3, axis=1))
    assert_close(mesh.vertices[mesh.faces], SQUARE[TRIANGLES], atol=1e-7)


def test_a_part_without_a_colour_is_grey_beside_coloured_ones(tmp_path: Path) -> None:
    mesh = load_mesh(write_obj(tmp_path, "newmtl a\nKd 1 0 0\nnewmtl b\n"), 1.0)
    assert mesh.colors is not None
    assert np.array_equal(mesh.colors[mesh.faces[1]], np.full((3, 3), 160))
    plain = write_obj(tmp_path, "newmtl a\nnewmtl b\n")
    assert load_mesh(plain, 1.0).colors is None


def test_materials_that_share_a_picture_keep_it(textured: Mesh, tmp_path: Path) -> None:
    picture(tmp_path / "skin.png")
    mesh = load_mesh(write_obj(tmp_path, "newmtl a\nmap_Kd skin.png\nnewmtl b\nmap_Kd skin.png\n"), 1.0)
    assert mesh.texture == tmp_path / "skin.png"
    assert_close(corners(mesh), corners(textured), atol=1e-7)


def test_several_pictures_become_one(tmp_path: Path) -> None:
    for name, color in (("one", RED), ("two", BLUE)):
        Image.new("RGB", (32, 32), color).save(tmp_path / f"{name}.png")
    path = write_obj(tmp_path, "newmtl a\nmap_Kd one.png\nnewmtl b\nmap_Kd two.png\n")
    mesh = load_mesh(path, 1.0, tmp_path / "pictures")
    assert mesh.texture == tmp_path / "pictures" / "square.png"
    assert mesh.uv is not None
    for face, color in zip(mesh.faces, (RED, BLUE), strict=True):
        assert color_at(mesh, mesh.uv[face].mean(0)) == color


def test_a_picture_beside_plain_colours_is_packed_with_them(tmp_path: Path) -> None:
    Image.new("RGB", (32, 32), RED).save(tmp_path / "one.png")
    path = write_obj(tmp_path, "newmtl a\nmap_Kd one.png\nnewmtl b\nKd 0 0 1\n")
    mesh = load_mesh(path, 1.0, tmp_path / "pictures")
    assert mesh.uv is not None
    for face, color in zip(mesh.faces, (RED, BLUE), strict=True):
        assert color_at(mesh, mesh.uv[face].mean(0)) == color


def write_glb(textured: Mesh, path: Path, factor: tuple[float, ...] | None = None) -> Path:
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.open(textured.texture), baseColorFactor=factor
    )
    visual = trimesh.visual.TextureVisuals(uv=textured.uv, material=material)
    trimesh.Trimesh(textured.vertices, textured.faces, visual=visual, process=False).export(path)
    return path


def test_a_picture_inside_a_glb_is_taken_out(textured: Mesh, tmp_path: Path) -> None:
    path = write_glb(textured, tmp_path / "part.glb")
    mesh = load_mesh(path, 1.0, tmp_path / "pictures")
    assert mesh.texture == tmp_path / "pictures" / "part.png"
    assert_close(corners(mesh), corners(textured), atol=1e-6)
    assert color_at(mesh, np.array([0.1, 0.9])) == RED
    assert color_at(mesh, np.array([0.9, 0.1])) == YELLOW


def test_several_pictures_inside_a_glb_become_one(textured: Mesh, tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for name, color, x in (("one", RED, 0.0), ("two", BLUE, 0.2)):
        material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.new("RGB", (32, 32), color))
        visual = trimesh.visual.TextureVisuals(uv=textured.uv, material=material)
        part = trimesh.Trimesh(textured.vertices, textured.faces, visual=visual, process=False)
        scene.add_geometry(part, name, name, transform=trimesh.transformations.translation_matrix([x, 0, 0]))
    scene.export(tmp_path / "pair.glb")
    mesh = load_mesh(tmp_path / "pair.glb", 1.0, tmp_path)
    assert mesh.uv is not None
    assert_close(mesh.box, [[0, 0, 0], [0.3, 0.1, 0]], atol=1e-6)
    for face in mesh.faces:
        assert color_at(mesh, mesh.uv[face].mean(0)) == (RED if mesh.vertices[face, 0].max() < 0.15 else BLUE)


def test_without_a_folder_it_becomes_colours_of_vertices(textured: Mesh, tmp_path: Path) -> None:
    mesh = load_mesh(write_glb(textured, tmp_path / "part.glb"), 1.0)
    assert mesh.texture is None
    assert mesh.colors is not None
    assert [tuple(c) for c in mesh.colors[mesh.faces[0]]] == [GREEN, YELLOW, BLUE]
    assert not (tmp_path / "part.png").exists()


def test_a_glb_tints_its_picture(textured: Mesh, tmp_path: Path) -> None:
    path = write_glb(textured, tmp_path / "part.glb", (0.5, 1.0, 1.0, 1.0))
    mesh = load_mesh(path, 1.0, tmp_path)
    assert np.abs(np.subtract(color_at(mesh, np.array([0.1, 0.9])), (127.5, 0, 0))).max() <= 1


@pytest.mark.parametrize("suffix", ["ply", "glb", "obj"])
def test_colours_of_vertices_are_kept(tmp_path: Path, suffix: str) -> None:
    colors = np.array([RED, GREEN, BLUE, YELLOW], dtype=np.uint8)
    made = trimesh.Trimesh(SQUARE, TRIANGLES, vertex_colors=colors, process=False)
    made.export(tmp_path / f"square.{suffix}")
    mesh = load_mesh(tmp_path / f"square.{suffix}", 1.0)
    assert mesh.colors is not None
    assert np.array_equal(mesh.colors[mesh.faces], colors[TRIANGLES])


def test_colours_of_faces_are_kept_by_splitting_vertices(tmp_path: Path) -> None:
    made = trimesh.Trimesh(SQUARE, TRIANGLES, face_colors=np.array([RED, BLUE], dtype=np.uint8), process=False)
    made.export(tmp_path / "square.ply")
    mesh = load_mesh(tmp_path / "square.ply", 1.0)
    assert mesh.colors is not None
    assert np.array_equal(mesh.colors[mesh.faces], np.repeat([[RED], [BLUE]], 3, axis=1))
    assert_close(mesh.vertices[mesh.faces], SQUARE[TRIANGLES], atol=1e-7)


@pytest.mark.parametrize("suffix", ["ply", "obj"])
def test_a_missing_picture_is_told(
    textured: Mesh, tmp_path: Path, suffix: str, caplog: pytest.LogCaptureFixture
) -> None:
    if suffix == "ply":
        path = tmp_path / "part.ply"
        save_ply(textured, path, 1.0)
        (tmp_path / "part.png").unlink()
    else:
        path = write_obj(tmp_path, "newmtl a\nmap_Kd part.png\nnewmtl b\nmap_Kd part.png\n")
    with caplog.at_level(logging.WARNING, "multicam"):
        mesh = load_mesh(path, 1.0)
    assert mesh.uv is None
    assert mesh.texture is None
    assert "is not there" in caplog.text


def test_a_broken_picture_is_refused(textured: Mesh, tmp_path: Path) -> None:
    save_ply(textured, tmp_path / "part.ply", 1.0)
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 256, (64, 64, 3), dtype=np.uint8)).save(tmp_path / "part.png")
    data = (tmp_path / "part.png").read_bytes()
    (tmp_path / "part.png").write_bytes(data[: len(data) // 2])
    with pytest.raises(DataError, match=r"part\.ply cannot be read"):
        load_mesh(tmp_path / "part.ply", 1.0)


def test_a_models_folder_carries_pictures(textured: Mesh, tmp_path: Path) -> None:
    plate = toy_meshes()[PLATE]
    uv = plate.vertices[:, :2] * 5 + 0.5
    mesh = Mesh(plate.vertices, plate.faces, uv=uv, texture=textured.texture)
    write_models(tmp_path / "models", Catalogue({PLATE: toy_catalogue()[PLATE]}), {PLATE: mesh})
    back = load_catalogue(tmp_path / "models")[PLATE].load_mesh()
    assert back.texture == tmp_path / "models" / "obj_000002.png"
    assert_close(corners(back), corners(mesh), atol=1e-6)


def test_arrays_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="both uv and texture"):
        Mesh(SQUARE, TRIANGLES, uv=SQUARE[:, :2])
    with pytest.raises(ValueError, match=r"uv must be \(4, 2\)"):
        Mesh(SQUARE, TRIANGLES, uv=SQUARE, texture=tmp_path / "a.png")
    with pytest.raises(ValueError, match=r"colors must be \(4, 3\)"):
        Mesh(SQUARE, TRIANGLES, colors=np.zeros((3, 3), dtype=np.uint8))
