"""Unlabelled things, and folders of one's own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from datagen.config import AssetsConfig, DatagenConfig, ObjectsConfig
from datagen.scenes.primitives import SHAPES, proportions, unit_shape
from datagen.scenes.sample import sample_scene
from datagen.scenes.spec import SceneSpec, Solid
from datagen.scenes.stock import Stock
from multicam.errors import ConfigError, DataError
from multicam.geometry.mesh import Mesh, save_ply

CONFIG = DatagenConfig(images=60, images_per_scene=1)


@pytest.mark.parametrize("shape", SHAPES)
def test_shapes_are_closed_and_face_outwards(shape: str) -> None:
    import trimesh

    mesh = unit_shape(shape)
    whole = trimesh.Trimesh(mesh.vertices, mesh.faces)
    assert whole.is_watertight
    assert 0.1 < whole.volume <= 1 + 1e-9


def scenes(config: DatagenConfig, stock: Stock, count: int = 30) -> list[SceneSpec]:
    return [sample_scene(config, stock, index) for index in range(count)]


def solids(config: DatagenConfig, stock: Stock) -> list[Solid]:
    return [solid for scene in scenes(config, stock) for solid in scene.solids]


def test_classes_that_are_not_labelled_lie_about(stock: Stock) -> None:
    labelled = stock.catalogue.obj_ids[:2]
    config = replace(CONFIG, objects=ObjectsConfig(classes=labelled))
    assert {o.obj_id for scene in scenes(config, stock) for o in scene.objects} == set(labelled)
    files = {Path(s.shape).name for s in solids(config, stock) if s.shape not in SHAPES}
    assert files == {f"obj_{i:06d}.ply" for i in stock.catalogue.obj_ids[2:]}
    with pytest.raises(ConfigError, match=r"\[99\]"):
        sample_scene(replace(CONFIG, objects=ObjectsConfig(classes=(1, 99))), stock, 0)


def test_an_unlabelled_part_has_its_own_size_and_place(stock: Stock) -> None:
    config = replace(CONFIG, objects=ObjectsConfig(classes=stock.catalogue.obj_ids[:2]))
    part = next(s for s in solids(config, stock) if s.shape not in SHAPES)
    obj_id = int(Path(part.shape).stem.split("_")[1])
    vertices = unit_shape(part.shape).vertices * part.size
    assert np.allclose(vertices, stock.meshes[obj_id].vertices - stock.meshes[obj_id].box.mean(axis=0), atol=1e-6)


def test_meshes_of_any_unit_become_distractors(stock: Stock, tmp_path: Path) -> None:
    huge = Mesh(
        1000 * np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 4.0]]),
        np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
    )
    save_ply(huge, tmp_path / "deeper" / "thing.ply", 1.0)
    config = replace(CONFIG, assets=AssetsConfig(distractors=tmp_path))
    mine = [s for s in solids(config, stock) if s.shape.endswith("thing.ply")]
    assert len(mine) > 20
    assert np.allclose(proportions(mine[0].shape), [0.25, 0.5, 1])
    for solid in mine:
        assert np.allclose(solid.size / solid.size.max(), [0.25, 0.5, 1])
        assert 0.03 <= solid.size.max() <= 0.15


def test_pictures_cover_surfaces_overlays_and_backgrounds(stock: Stock, tmp_path: Path) -> None:
    for name in ("b.png", "a.jpg"):
        cv2.imwrite(str(tmp_path / name), np.zeros((4, 4, 3), np.uint8))
    config = replace(CONFIG, assets=AssetsConfig(textures=tmp_path, backgrounds=tmp_path))
    made = scenes(config, stock)
    names = {str((tmp_path / name).resolve()) for name in ("a.jpg", "b.png")}
    assert {s.surface.picture for scene in made for s in scene.solids} - {None} == names
    assert {o.picture for scene in made for shot in scene.shots for o in shot.overlays} - {None} <= names
    backdrops = [scene.surroundings.backdrop for scene in made]
    assert {b.picture for b in backdrops if b is not None} == names
    assert 8 < sum(b is None for b in backdrops) < 22


def test_environment_maps_of_ones_own(stock: Stock, tmp_path: Path) -> None:
    (tmp_path / "sky.hdr").write_bytes(b"")
    config = replace(CONFIG, assets=AssetsConfig(hdris=tmp_path))
    assert {scene.surroundings.hdri for scene in scenes(config, stock)} == {None, str((tmp_path / "sky.hdr").resolve())}


def test_folders_without_assets_are_named(stock: Stock, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"assets\.textures is .*nowhere"):
        DatagenConfig(assets=AssetsConfig(textures=tmp_path / "nowhere"))
    with pytest.raises(DataError, match=r"holds none of the files.*\.jpg"):
        sample_scene(replace(CONFIG, assets=AssetsConfig(textures=tmp_path)), stock, 0)


def test_occluders_hang_above_the_ground(stock: Stock) -> None:
    with_them = sample_scene(CONFIG, stock, 3)
    without = sample_scene(replace(CONFIG, randomize=replace(CONFIG.randomize, occluders=False)), stock, 3)
    extra = with_them.solids[len(without.solids) :]
    assert len(extra) <= 3
    for solid in extra:
        corners = unit_shape(solid.shape).vertices * solid.size @ solid.world_from_solid[:3, :3].T
        assert (corners + solid.world_from_solid[:3, 3])[:, 2].min() > 0.009
