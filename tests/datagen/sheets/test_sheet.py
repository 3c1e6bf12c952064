"""The inspection sheet: what is drawn lies where it should, and the page needs nothing beside it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from datagen.cli import main
from datagen.sheets.labels import find_splits, read_split
from datagen.sheets.objects import HEIGHT, WIDTH, object_views
from datagen.sheets.page import write_sheet
from datagen.sheets.shade import Shaded, View
from multicam.dataset.bop_writer import InstanceLabels, LabelledImage, SceneWriter, write_models
from multicam.dataset.objects import Catalogue
from multicam.errors import DataError
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import render_depth
from multicam.geometry.symmetry import Symmetries
from multicam.progress import SilentProgress
from tests.toy_objects import BRACKET, PEG, PLATE, ROD, toy_catalogue, toy_meshes

FRONT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def lines(markup: str, color: str) -> list[np.ndarray]:
    """(2, 2) ends of the lines of a colour."""
    found = re.findall(r'<line x1="(\S+)" y1="(\S+)" x2="(\S+)" y2="(\S+)" stroke="(\S+)"', markup)
    return [np.array([float(v) for v in row[:4]]).reshape(2, 2) for row in found if row[4] == color]


def longest(markup: str, color: str) -> float:
    return max(float(np.linalg.norm(line[1] - line[0])) for line in lines(markup, color))


@pytest.mark.parametrize("obj_id", [BRACKET, PLATE])
def test_arrows_are_as_long_as_what_they_measure(obj_id: int) -> None:
    """Against the bar of known length in the same view."""
    mesh = toy_meshes()[obj_id]
    front, right, above = object_views(toy_catalogue()[obj_id], mesh)[:3]
    size = 1000 * (mesh.box[1] - mesh.box[0])
    for markup, across, up in ((front, 0, 2), (right, 1, 2), (above, 0, 1)):
        bar = float(re.search(r">(\d+) mm<", markup)[1])  # pyright: ignore[reportOptionalSubscript]
        scale = longest(markup, "#1d2430") / bar
        for axis in (across, up):
            color = ("#d1242f", "#1a7f37", "#0969da")[axis]
            assert longest(markup, color) == pytest.approx(size[axis] * scale, abs=0.6)
            assert f"{'xyz'[axis]} {size[axis]:.1f} mm" in markup


def test_drawings_are_well_formed_and_stay_in_their_frame() -> None:
    for markup in object_views(toy_catalogue()[PEG], toy_meshes()[PEG]):
        root = ET.fromstring(markup)
        assert root.attrib["viewBox"] == f"0 0 {WIDTH} {HEIGHT}"
        for text in root.iter("{http://www.w3.org/2000/svg}text"):
            assert 0 <= float(text.attrib["x"]) <= WIDTH
            assert 0 <= float(text.attrib["y"]) <= HEIGHT


def test_all_keypoints_are_numbered_and_hidden_ones_hollow() -> None:
    model = toy_catalogue()[PLATE]
    views = object_views(model, toy_meshes()[PLATE])[3:]
    assert model.keypoints is not None
    for markup in views:
        assert re.findall(r">(\d)</text>", markup) == [str(i) for i in range(8)]
    # What one side shows the other hides: the two views look from opposite sides.
    hollow = [np.array([fill == "none" for fill in re.findall(r'<circle [^>]*fill="(\S+)"', m)]) for m in views]
    assert 0 < hollow[0].sum() < 8
    assert not np.any(hollow[0] & hollow[1])
    # The first one looks from the front right, above: that corner of the plate is nearest to it.
    nearest = int((model.keypoints @ [0.5, -0.7, 0.5]).argmax())
    assert not hollow[0][nearest]
    assert hollow[1][nearest]


def test_axes_of_symmetry_are_drawn_solid_if_continuous() -> None:
    peg, plate, bracket = (
        object_views(toy_catalogue()[obj_id], toy_meshes()[obj_id])[3] for obj_id in (PEG, PLATE, BRACKET)
    )
    assert ">any angle<" in peg
    assert "stroke-dasharray" not in peg
    assert plate.count(">180°<") == 3
    assert plate.count("stroke-dasharray") == 3
    assert lines(bracket, "#8250df") == []


def test_the_software_picture_agrees_with_the_rasterizer() -> None:
    mesh = toy_meshes()[BRACKET]
    view = View(FRONT, mesh.box.mean(0), 1500.0, 240, 200)
    picture, depth = Shaded(mesh).draw(view, colored=False)
    pixels = view.project(mesh.vertices)
    seen = np.isfinite(depth)
    rows, columns = np.nonzero(seen)
    assert [columns.min(), rows.min()] == pytest.approx(pixels.min(0), abs=2.5)
    assert [columns.max(), rows.max()] == pytest.approx(pixels.max(0), abs=2.5)
    assert np.all(picture[0, 0] == 255)
    assert picture[seen].mean() < 200
    # The far away camera of the view, put in by hand.
    distance = 40 * mesh.diameter()
    camera = Camera.from_focal(1500 * distance, 240, 200)
    pose = se3.from_parts(FRONT, np.array([0, 0, distance]) - FRONT @ mesh.box.mean(0))
    own = render_depth(mesh, camera, pose)
    both = seen & (own > 0)
    assert both.sum() > 0.98 * seen.sum()
    assert np.median(np.abs(depth[both] + distance - own[both])) < 1e-3


def test_sides_turned_to_the_lamp_are_lighter() -> None:
    mesh = toy_meshes()[PLATE]
    rotation = np.array([[1.0, 0, 0], [0, -0.6, -0.8], [0, 0.8, -0.6]])
    view = View(rotation, mesh.box.mean(0), 1500.0, 240, 200)
    picture, _ = Shaded(mesh).draw(view, colored=False)
    # The upper side of the plate, and its front edge below it.
    top, edge = (view.project(np.array([point]))[0].round().astype(int) for point in ([0, 0, 0.01], [0, -0.03, 0]))
    assert picture[top[1], top[0]].mean() > picture[edge[1], edge[0]].mean() + 10


def test_colours_and_pictures_show(tmp_path: Path) -> None:
    mesh = toy_meshes()[PLATE]
    view = View(np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]]), mesh.box.mean(0), 1500.0, 240, 200)
    left_red = np.where(mesh.vertices[:, :1] < 0, [255, 0, 0], [0, 0, 255]).astype(np.uint8)
    tiles = np.array([[[255, 0, 0], [0, 0, 255]], [[255, 255, 0], [0, 255, 255]]], dtype=np.uint8)
    Image.fromarray(tiles).save(tmp_path / "a.png")
    uv = mesh.vertices[:, :2] / [0.1201, 0.0601] + 0.5
    for painted in (replace(mesh, colors=left_red), replace(mesh, uv=uv, texture=tmp_path / "a.png")):
        picture, _ = Shaded(painted).draw(view, colored=True)
        left, right = picture[80, 40].astype(int), picture[80, 200].astype(int)
        assert left[0] > left[2] + 60
        assert right[2] > right[0] + 60
    # The last one's lower half is green beside red or blue.
    assert picture[80, 40, 1] < 60
    assert picture[120, 40, 1] > 100


@pytest.fixture
def data(models: Path, tmp_path: Path) -> Path:
    """Two splits of tiny labelled pictures, the first with a seed."""
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "models").symlink_to(models)
    mask = np.zeros((48, 64), dtype=bool)
    mask[10:30, 20:50] = True
    pose = se3.from_parts(np.eye(3), np.array([0, 0, 0.6]))
    labels = [
        InstanceLabels(
            obj_id, pose, np.array([19.5, 9.5, 49.5, 29.5]), mask, mask, share, 600,
            np.tile([30.0, 20.0], (8, 1)), np.array([True] * 4 + [False] * 4),
        )
        for obj_id, share in ((PLATE, 0.9), (ROD, 0.05))
    ]  # fmt: skip
    picture = LabelledImage(
        Camera.from_focal(60.0, 64, 48), np.eye(4), np.full((48, 64, 3), 90, dtype=np.uint8),
        np.zeros((48, 64), dtype=np.float32), tuple(labels),
    )  # fmt: skip
    for split, count in (("train", 2), ("val", 1)):
        for scene in range(count):
            writer = SceneWriter(folder / split / f"{scene:06d}")
            for im_id in range(8):
                writer.add(im_id, picture)
    (folder / "train" / "config.yaml").write_text("seed: 5\n")
    (folder / "notes").mkdir()
    return folder


class Links(HTMLParser):
    """Collects what a page would load."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [value or "" for name, value in attrs if name in ("src", "href", "data")]


def test_one_page_shows_a_data_set_and_loads_nothing(data: Path) -> None:
    main(["inspect", str(data)])
    page = (data / "inspect.html").read_text()
    links = Links()
    links.feed(page)
    assert links.found
    assert all(link.startswith(("data:image/", "#")) for link in links.found)
    assert "http" not in page.replace("http://www.w3.org", "")
    for name in ("bracket", "plate", "peg", "rod", "pyramid", "wedge"):
        assert f"<h2>{name}<span>" in page
    assert "120.0 × 60.0 × 20.0 mm" in page
    assert "Symmetry: 180° about x, y, z" in page
    assert "Symmetry: any angle about (" not in page
    assert "train: 16 pictures in 2 scenes, 32 labelled objects, seed 5." in page
    assert page.count("<figure") == 12 + 8
    assert "seed 5, scene 1, image 7" in page
    assert "please confirm" not in page


def test_a_print_may_break_what_the_shape_alone_has(tmp_path: Path) -> None:
    """Symmetries that the models state and those of the shape are told apart."""
    stated_none = Catalogue({PLATE: replace(toy_catalogue()[PLATE], symmetries=Symmetries())})
    write_models(tmp_path / "models", stated_none, {PLATE: toy_meshes()[PLATE]})
    write_sheet(tmp_path / "models", tmp_path / "page.html", SilentProgress())
    assert "By its shape alone it has: 180° about" in (tmp_path / "page.html").read_text()


def test_splits_are_found_and_read(data: Path) -> None:
    assert [path.name for path in find_splits(data)] == ["train", "val"]
    split = read_split(data / "train", SilentProgress())
    assert (split.seed, split.scenes, len(split.pictures), len(split.instances)) == (5, 2, 16, 32)
    assert read_split(data / "val", SilentProgress()).seed is None


def test_a_folder_without_models_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="models_info"):
        main(["inspect", str(tmp_path)])
    with pytest.raises(DataError, match="does not exist"):
        main(["inspect", "--data", str(tmp_path / "nowhere")])


def test_a_mesh_without_colours_is_grey() -> None:
    mesh = toy_meshes()[PLATE]
    assert not Shaded(Mesh(mesh.vertices, mesh.faces)).has_colors
