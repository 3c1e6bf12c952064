"""What the writer writes the reader reads, also after the writer was killed at any moment."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from multicam.dataset import bop_writer
from multicam.dataset.bop_reader import ImageRecord, list_scenes, read_depth, read_image, read_scene
from multicam.dataset.bop_writer import LabelledImage, SceneWriter
from multicam.errors import DataError
from multicam.geometry import se3
from tests.close import assert_close
from tests.dataset.labelled import CAMERA, labelled_image
from tests.strategies import Array, seeds, transforms


def check(record: ImageRecord, picture: LabelledImage) -> None:
    """Holds a record equal to the picture that was written."""
    assert record.camera_matrix is not None and record.camera_from_world is not None
    assert_close(record.camera_matrix, picture.camera.matrix, atol=0)
    assert_close(record.camera_from_world, picture.camera_from_world, atol=1e-12)
    assert record.rgb_path is not None and record.depth_path is not None
    difference = read_image(record.rgb_path).astype(int) - picture.image
    assert np.abs(difference).mean() < 3
    assert_close(read_depth(record.depth_path, record.depth_scale), picture.depth, atol=1e-6)
    assert len(record.instances) == len(picture.instances)
    for found, written in zip(record.instances, picture.instances, strict=True):
        assert found.obj_id == written.obj_id
        assert_close(found.camera_from_object, written.camera_from_object, atol=1e-12)
        assert_close(found.box, written.box)
        assert found.visible_fraction == pytest.approx(written.visible_fraction)
        assert_close(found.keypoints, written.keypoints)
        assert np.array_equal(found.keypoints_visible, written.keypoints_visible)


@settings(max_examples=20)
@given(seeds(), transforms(), st.lists(st.integers(1, 6), max_size=3))
def test_an_image_comes_back_as_it_was_written(
    tmp_path_factory: pytest.TempPathFactory, rng: np.random.Generator, pose: Array, obj_ids: list[int]
) -> None:
    folder = tmp_path_factory.mktemp("scene", numbered=True) / "000007"
    picture = labelled_image(rng, tuple(obj_ids), camera_from_world=pose)
    SceneWriter(folder).add(42, picture)
    (record,) = read_scene(folder)
    assert (record.scene_id, record.im_id) == (7, 42)
    check(record, picture)
    for path, row in zip(record.mask_visib_paths, picture.instances, strict=True):
        assert np.array_equal(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) > 0, row.mask_visible)


def test_images_come_back_in_order_of_their_numbers(tmp_path: Path, rng: np.random.Generator) -> None:
    writer = SceneWriter(tmp_path / "000001")
    for im_id in (10, 9, 100, 0):
        writer.add(im_id, labelled_image(rng))
    assert [record.im_id for record in read_scene(tmp_path / "000001")] == [0, 9, 10, 100]
    assert SceneWriter(tmp_path / "000001").completed == {0, 9, 10, 100}


def test_files_hold_what_the_bop_format_says(tmp_path: Path, rng: np.random.Generator) -> None:
    folder = tmp_path / "000001"
    picture = labelled_image(rng, (3,))
    SceneWriter(folder).add(5, picture)
    row = picture.instances[0]
    (truth,) = json.loads((folder / "scene_gt.json").read_text())["5"]
    assert truth["obj_id"] == 3
    assert_close(truth["cam_R_m2c"], row.camera_from_object[:3, :3].ravel())
    assert_close(truth["cam_t_m2c"], 1000 * row.camera_from_object[:3, 3])
    camera = json.loads((folder / "scene_camera.json").read_text())["5"]
    assert_close(camera["cam_K"], CAMERA.matrix.ravel())
    assert_close(camera["cam_t_w2c"], 1000 * picture.camera_from_world[:3, 3])
    (info,) = json.loads((folder / "scene_gt_info.json").read_text())["5"]
    assert info["bbox_obj"] == [-3.5, 4.25, 44.5, 43.5]
    ys, xs = np.nonzero(row.mask_visible)
    assert info["bbox_visib"] == [xs.min(), ys.min(), np.ptp(xs) + 1, np.ptp(ys) + 1]
    assert info["px_count_all"] == 640
    assert info["px_count_valid"] == row.mask.sum()
    assert info["px_count_visib"] == row.mask_visible.sum()
    raw = cv2.imread(str(folder / "depth" / "000005.png"), cv2.IMREAD_UNCHANGED)
    assert raw.dtype == np.uint16
    assert_close(raw * camera["depth_scale"], 1000 * picture.depth, atol=0.051)
    assert {p.name for p in (folder / "mask").iterdir()} == {"000005_000000.png"}


def test_an_instance_nobody_sees_has_the_empty_box_of_the_format(tmp_path: Path, rng: np.random.Generator) -> None:
    picture = labelled_image(rng, (1,))
    picture.instances[0].mask_visible[:] = False
    SceneWriter(tmp_path / "000001").add(0, picture)
    (info,) = json.loads((tmp_path / "000001" / "scene_gt_info.json").read_text())["0"]
    assert info["bbox_visib"] == [-1, -1, -1, -1]


def test_depth_beyond_sixteen_bits_is_unknown(tmp_path: Path, rng: np.random.Generator) -> None:
    picture = labelled_image(rng)
    picture.depth[20:] = 9.0
    SceneWriter(tmp_path / "000001").add(0, picture)
    (record,) = read_scene(tmp_path / "000001")
    assert record.depth_path is not None
    depth = read_depth(record.depth_path, record.depth_scale)
    assert (depth[20:] == 0).all()
    assert_close(depth[:20], picture.depth[:20], atol=1e-6)


class Killed(BaseException):
    """Stands for a signal; no handler of ordinary errors may catch it."""


def kill_at(monkeypatch: pytest.MonkeyPatch, call: int) -> None:
    """Makes the given write, counted over all files of the writer, the one that never happens."""
    count = 0

    def guarded(write: Any) -> Any:
        def write_or_die(path: Path, value: Any) -> None:
            nonlocal count
            count += 1
            if count > call:
                raise Killed
            write(path, value)

        return write_or_die

    monkeypatch.setattr(bop_writer, "write_bytes", guarded(bop_writer.write_bytes))
    monkeypatch.setattr(bop_writer, "write_json", guarded(bop_writer.write_json))


# One image with two objects is rgb, depth, four masks and four tables.
@pytest.mark.parametrize("call", range(10))
def test_a_writer_killed_at_any_write_leaves_no_half_labelled_image(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: int
) -> None:
    pictures = [labelled_image(np.random.default_rng(seed)) for seed in range(3)]
    folder = tmp_path / "000001"
    SceneWriter(folder).add(0, pictures[0])
    with monkeypatch.context() as patch:
        kill_at(patch, call)
        with pytest.raises(Killed):
            SceneWriter(folder).add(1, pictures[1])

    assert SceneWriter(folder).completed == {0}
    assert [record.im_id for record in read_scene(folder)] == [0]

    resumed = SceneWriter(folder)
    for im_id in sorted({0, 1, 2} - resumed.completed):
        resumed.add(im_id, pictures[im_id])
    for record, picture in zip(read_scene(folder), pictures, strict=True):
        check(record, picture)
    fresh = SceneWriter(tmp_path / "000002")
    for im_id, picture in enumerate(pictures):
        fresh.add(im_id, picture)
    assert content(folder) == content(tmp_path / "000002")


def test_an_image_that_is_not_written_again_leaves_no_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    writer = SceneWriter(tmp_path / "000001")
    writer.add(0, labelled_image(rng))
    with monkeypatch.context() as patch:
        kill_at(patch, 9)
        with pytest.raises(Killed):
            writer.add(1, labelled_image(rng))
    SceneWriter(tmp_path / "000001").add(2, labelled_image(rng))
    for name in ("scene_camera", "scene_gt_info", "scene_keypoints", "scene_gt"):
        assert json.loads((tmp_path / "000001" / f"{name}.json").read_text()).keys() == {"0", "2"}


def test_a_kill_before_the_first_commit_leaves_an_empty_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    with monkeypatch.context() as patch:
        kill_at(patch, 10)
        with pytest.raises(Killed):
            SceneWriter(tmp_path / "000001").add(0, labelled_image(rng))
    assert SceneWriter(tmp_path / "000001").completed == set()
    assert read_scene(tmp_path / "000001") == []


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_scenes_are_listed_by_number_and_other_folders_left_out(tmp_path: Path) -> None:
    for name in ("000010", "000002", "models", "notes.txt"):
        (tmp_path / name).mkdir()
    assert [p.name for p in list_scenes(tmp_path)] == ["000002", "000010"]
    with pytest.raises(DataError, match="holds no scene folders"):
        list_scenes(tmp_path / "models")
    with pytest.raises(DataError, match="does not exist"):
        list_scenes(tmp_path / "absent")


def test_a_scene_without_truth_lists_every_image(tmp_path: Path, rng: np.random.Generator) -> None:
    writer = SceneWriter(tmp_path / "000001")
    for im_id in range(2):
        writer.add(im_id, labelled_image(rng))
    for name in ("scene_gt", "scene_gt_info", "scene_keypoints"):
        (tmp_path / "000001" / f"{name}.json").unlink()
    records = read_scene(tmp_path / "000001")
    assert [(r.im_id, r.instances, r.mask_visib_paths) for r in records] == [(0, (), ()), (1, (), ())]


def test_published_scenes_are_read(bench_dir: Path) -> None:
    """Real BOP folders: poses without images, without intrinsics, and with both."""
    ycbv = read_scene(bench_dir / "ycbv" / "test" / "000048")
    assert len(ycbv[0].instances) > 2
    assert ycbv[0].rgb_path is None
    assert all(0.2 < i.camera_from_object[2, 3] < 2 for i in ycbv[0].instances)
    tless = read_scene(bench_dir / "tless" / "test" / "000001")
    assert tless[0].camera_matrix is None
    scene = list_scenes(bench_dir / "lmo" / "test")[0]
    lmo = read_scene(scene)[0]
    assert lmo.rgb_path is not None
    assert read_image(lmo.rgb_path).shape == (480, 640, 3)
    assert lmo.camera_from_world is not None
    assert_close(lmo.camera_from_world @ se3.inverse(lmo.camera_from_world), np.eye(4))
