"""Faults in BOP scenes: each gives one sentence that names the file and the image."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from multicam.dataset.bop_reader import read_depth, read_image, read_scene
from multicam.dataset.bop_writer import SceneWriter
from tests.dataset.labelled import labelled_image
from tests.faults import edit_json, sentence
from tests.pictures import noise_image


@pytest.fixture
def scene(tmp_path: Path, rng: np.random.Generator) -> Path:
    """A scene of two images."""
    folder = tmp_path / "000001"
    writer = SceneWriter(folder)
    for im_id in (3, 4):
        writer.add(im_id, labelled_image(rng))
    return folder


def set_entry(key: str, index: int, name: str, value: Any) -> Callable[[Any], None]:
    return lambda table: table[key][index].__setitem__(name, value)


@pytest.mark.parametrize(
    ("edit", "expected"),
    [
        (
            set_entry("4", 0, "cam_t_m2c", [1, 2, float("nan")]),
            "image 4 does not follow the BOP format: pose holds NaN",
        ),
        (set_entry("4", 1, "cam_R_m2c", [float("inf")] * 9), "image 4 does not follow the BOP format: pose holds NaN"),
        (
            set_entry("3", 0, "cam_R_m2c", [1, 0, 0, 0, 1, 0, 0, 0]),
            "image 3 .* 9 rotation and 3 translation .* got 8 and",
        ),
        (set_entry("3", 0, "cam_R_m2c", [2, 0, 0, 0, 2, 0, 0, 0, 2]), "image 3 .* not orthonormal"),
        (set_entry("3", 0, "cam_R_m2c", [1, 0, 0, 0, 1, 0, 0, 0, -1]), "image 3 .* mirrors"),
        (set_entry("3", 0, "obj_id", "screw"), "image 3 .* 'screw'"),
        (lambda table: table["3"][0].pop("cam_t_m2c"), 'image 3 .* "cam_t_m2c" is missing'),
        (lambda table: table.__setitem__("3", ["x"]), "image 3 does not follow"),
        (lambda table: table.__setitem__("x", []), "scene_gt.json must map image numbers"),
    ],
)
def test_faulty_truth_is_refused_with_its_image(scene: Path, edit: Callable[[Any], None], expected: str) -> None:
    edit_json(scene / "scene_gt.json", edit)
    assert expected_in(expected, sentence(lambda: read_scene(scene)))


@pytest.mark.parametrize(
    ("edit", "expected"),
    [
        (lambda table: table["3"].__setitem__("cam_K", [1, 2, 3]), "image 3 .* cam_K is no camera matrix"),
        (lambda table: table["3"].__setitem__("cam_K", [float("nan")] * 9), "image 3 .* cam_K is no camera matrix"),
        (lambda table: table["3"].__setitem__("cam_K", [0] * 9), "image 3 .* cam_K is no camera matrix"),
        (lambda table: table["4"].__setitem__("cam_t_w2c", [0, float("nan"), 0]), "image 4 .* pose holds NaN"),
        (lambda table: table["4"].pop("cam_t_w2c"), 'image 4 .* "cam_t_w2c" is missing'),
        (lambda table: table["4"].__setitem__("depth_scale", "big"), "image 4 .* 'big'"),
        (lambda table: table.__setitem__("4", "K"), "image 4 .* expected an object in scene_camera.json"),
    ],
)
def test_faulty_cameras_are_refused_with_their_image(scene: Path, edit: Callable[[Any], None], expected: str) -> None:
    edit_json(scene / "scene_camera.json", edit)
    assert expected_in(expected, sentence(lambda: read_scene(scene)))


def test_labels_that_are_fewer_than_the_objects_are_refused(scene: Path) -> None:
    edit_json(scene / "scene_gt_info.json", lambda table: table["3"].pop())
    assert "image 3 does not follow" in sentence(lambda: read_scene(scene))


@pytest.mark.parametrize("name", ["scene_camera", "scene_gt", "scene_gt_info", "scene_keypoints"])
@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b'{"3": ', r"is not valid JSON: Expecting value at line 1, column 7"),
        (b"", "is not valid JSON: Expecting value at line 1, column 1"),
        (b"[1, 2]", "must map image numbers to their data"),
        (b'{"a": "\xff"}', "is not a text file: byte 7 is not UTF-8"),
    ],
)
def test_malformed_json_is_refused(scene: Path, name: str, content: bytes, expected: str) -> None:
    (scene / f"{name}.json").write_bytes(content)
    text = sentence(lambda: read_scene(scene))
    assert str(scene / f"{name}.json") in text
    assert expected in text


def test_a_missing_scene_is_refused_with_the_nearest_folder(scene: Path) -> None:
    absent = scene.parent / "000009"
    assert f"nearest existing folder is {scene.parent}" in sentence(lambda: read_scene(absent))
    (scene / "scene_camera.json").unlink()
    assert "scene_camera.json does not exist" in sentence(lambda: read_scene(scene))


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_any_prefix_of_an_image_is_refused(tmp_path: Path, rng: np.random.Generator, suffix: str) -> None:
    data = cv2.imencode(suffix, noise_image(16, 12, rng))[1].tobytes()
    path = tmp_path / f"cut{suffix}"
    for size in (*range(0, len(data), 13), *range(len(data) - 16, len(data))):
        path.write_bytes(data[:size])
        assert "truncated" in sentence(lambda: read_image(path))
    path.write_bytes(data)
    assert read_image(path).shape == (12, 16, 3)


def test_a_decoder_that_fills_missing_ends_with_grey_is_not_trusted(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As OpenCV before 4.11 does; a thumbnail in the header has an end marker of its own."""
    thumbnail = cv2.imencode(".jpg", noise_image(16, 12, rng))[1].tobytes()
    data = cv2.imencode(".jpg", noise_image(160, 120, rng))[1].tobytes()
    segment = b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail
    data = data[:2] + segment + data[2:]
    path = tmp_path / "photo.jpg"
    path.write_bytes(data)
    assert read_image(path).shape == (120, 160, 3)
    monkeypatch.setattr(cv2, "imdecode", lambda data, flags: np.full((120, 160, 3), 128, dtype=np.uint8))
    assert read_image(path).shape == (120, 160, 3)
    for size in (0, 2, 3, 5, 9, 40, 300, len(thumbnail), len(segment) + 10, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:size])
        assert "truncated" in sentence(lambda: read_image(path))


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_what_cameras_append_to_an_image_does_no_harm(tmp_path: Path, rng: np.random.Generator, suffix: str) -> None:
    path = tmp_path / f"photo{suffix}"
    picture = noise_image(160, 120, rng)
    cv2.imwrite(str(path), picture)
    path.write_bytes(path.read_bytes() + b"maker's trailer" * 100)
    assert np.abs(read_image(path)[:, :, ::-1].astype(int) - picture).mean() < 3


def test_colours_come_in_the_order_red_green_blue(tmp_path: Path) -> None:
    red = np.zeros((8, 8, 3), dtype=np.uint8)
    red[..., 2] = 255
    cv2.imwrite(str(tmp_path / "red.png"), red)
    assert (read_image(tmp_path / "red.png") == [255, 0, 0]).all()
    cv2.imwrite(str(tmp_path / "grey.png"), red[..., 2])
    assert read_image(tmp_path / "grey.png").shape == (8, 8, 3)


@pytest.mark.parametrize("content", [b"", b"no image at all", b"\xff\xd8\xff\xd9"])
def test_rubbish_is_no_image_and_no_depth(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "image.png"
    path.write_bytes(content)
    assert f"{path} is not a readable image ({len(content)} bytes)" in sentence(lambda: read_image(path))
    assert f"{path} is not a readable image ({len(content)} bytes)" in sentence(lambda: read_depth(path, 1.0))


def test_depth_needs_a_whole_file_of_one_channel(scene: Path) -> None:
    path = scene / "depth" / "000003.png"
    path.write_bytes(path.read_bytes()[:-20])
    assert "truncated" in sentence(lambda: read_depth(path, 0.1))
    assert "3 channels; a depth image has one" in sentence(lambda: read_depth(scene / "rgb" / "000003.jpg", 0.1))
    assert "absent.png does not exist" in sentence(lambda: read_depth(scene / "absent.png", 0.1))


def expected_in(pattern: str, text: str) -> bool:
    """Whether the parts of a pattern, divided by ' .* ', stand in the text in this order."""
    position = 0
    for part in pattern.split(" .* "):
        position = text.find(part, position)
        if position < 0:
            raise AssertionError(f"{part!r} not in {text!r}")
    return True
