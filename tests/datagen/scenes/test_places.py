"""What the objects lie on and stand in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from datagen.config import DatagenConfig, ObjectsConfig, PlacesConfig, RandomizationConfig
from datagen.scenes.places import KINDS
from datagen.scenes.sample import sample_scene
from datagen.scenes.spec import SceneSpec, Solid
from datagen.scenes.stock import Stock
from multicam.errors import ConfigError
from multicam.geometry import se3

BARE = RandomizationConfig(distractors=False, occluders=False)


def only(kind: str) -> DatagenConfig:
    shares = {name: float(name == kind) for name in KINDS}
    return DatagenConfig(images=40, images_per_scene=1, places=PlacesConfig(**shares), randomize=BARE)


def boards(scene: SceneSpec) -> list[Solid]:
    """Upright solids that are thin: the sides of a bin."""
    return [s for s in scene.solids if s.world_from_solid[2, 3] > 0 and s.size[2] < 0.1 and s.size[:2].min() < 0.01]


def points(scene: SceneSpec, stock: Stock) -> np.ndarray:
    return np.concatenate([se3.act(o.world_from_object, stock.meshes[o.obj_id].vertices) for o in scene.objects])


@pytest.mark.parametrize("index", range(5))
def test_a_bin_stands_around_everything_in_it(stock: Stock, index: int) -> None:
    scene = sample_scene(only("box"), stock, index)
    sides = boards(scene)
    assert len(sides) == 4
    cloud = points(scene, stock)[:, :2]
    for axis in (0, 1):
        across = [s for s in sides if s.size[axis] < 0.01]
        edges = sorted(float(s.world_from_solid[axis, 3]) for s in across)
        assert edges[0] + 0.002 < cloud[:, axis].min()
        assert cloud[:, axis].max() < edges[1] - 0.002


def test_in_the_air_there_is_no_ground_and_cameras_look_from_below_too(stock: Stock) -> None:
    heights = []
    for index in range(12):
        scene = sample_scene(only("air"), stock, index)
        assert scene.solids == ()
        assert points(scene, stock)[:, 2].min() > 0
        heights += [float(shot.world_from_camera[2, 2]) for shot in scene.shots]
    assert min(heights) < 0 < max(heights)


@pytest.mark.parametrize("kind", ["table", "floor", "box"])
def test_elsewhere_the_ground_is_at_zero(stock: Stock, kind: str) -> None:
    spread = replace(only(kind), objects=ObjectsConfig(0.0, loose=(4, 4), pile_fraction=0.0, air_fraction=0.0))
    scene = sample_scene(spread, stock, 0)
    tops = [s.world_from_solid[2, 3] + s.size[2] / 2 for s in scene.solids if s.size[:2].min() > 0.9]
    assert np.isclose(max(t for t in tops if t < 0.02), 0)
    assert points(scene, stock)[:, 2].min() == pytest.approx(0, abs=1e-9)


def test_every_kind_has_its_share(stock: Stock) -> None:
    config = replace(only("box"), images=200, places=PlacesConfig(table=1, floor=1, box=1, air=1))
    found = {"box": 0, "air": 0}
    for index in range(200):
        scene = sample_scene(config, stock, index)
        found["air"] += not scene.solids
        found["box"] += len(boards(scene)) == 4
    assert all(30 < count < 70 for count in found.values())


def test_switched_off_everything_is_on_a_table(stock: Stock) -> None:
    config = replace(only("air"), randomize=replace(BARE, places=False))
    assert max(s.size[0] for s in sample_scene(config, stock, 0).solids) > 1


def test_impossible_shares_are_refused() -> None:
    with pytest.raises(ConfigError, match="places"):
        DatagenConfig(places=PlacesConfig(table=0, floor=0, box=0, air=0))
    with pytest.raises(ConfigError, match="places"):
        DatagenConfig(places=PlacesConfig(table=-1))
