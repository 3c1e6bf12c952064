"""The pictures that are taken of a scene: where from, through what lens, how well."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from datagen.config import CameraConfig, DatagenConfig
from datagen.scenes.looks import random_color
from datagen.scenes.primitives import mesh_of
from datagen.scenes.spec import Lens, Motion, Overlay, PlacedInstance, Shot, Solid
from datagen.scenes.stock import Stock
from datagen.scenes.viewpoints import sample_camera, sample_viewpoint
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.types import FloatArray

_OVERLAID = 1 / 3
"""Share of pictures with overlays."""


def sample_shots(
    config: DatagenConfig,
    stock: Stock,
    objects: Sequence[PlacedInstance],
    solids: Sequence[Solid],
    count: int,
    pictures: Sequence[str],
    rng: np.random.Generator,
    floating: bool = False,
) -> tuple[Shot, ...]:
    """Shots of objects that stand among solids; each has a stream of its own, and each kind of error one of its own.

    Args:
        pictures: image files that overlays may show.
        floating: nothing lies beneath the objects, so they are seen from below, too.
    """
    targets = np.stack([o.world_from_object[:3, 3] for o in objects])
    clouds = [se3.act(o.world_from_object, stock.bodies[o.obj_id].points[::4]) for o in objects]
    obstacles = np.concatenate(clouds + [se3.act(s.world_from_solid, mesh_of(s).vertices) for s in solids])
    shots: list[Shot] = []
    for stream in rng.spawn(count):
        where, sensor, optics, moving, patches, store = stream.spawn(6)
        camera = sample_camera(config.camera, config.width, config.height, where)
        pose = sample_viewpoint(config.camera, camera, targets, clouds, obstacles, where, floating)
        distance = float(np.median(np.linalg.norm(targets - pose[:3, 3], axis=1)))
        randomize = config.randomize
        shots.append(
            Shot(
                camera,
                pose,
                exposure=float(sensor.normal(0, 0.35)) if randomize.exposure else 0.0,
                noise=float(sensor.uniform(0, 0.012)) if randomize.exposure else 0.0,
                lens=_sample_lens(config.camera, targets, pose, optics) if randomize.lens else Lens(),
                motion=_sample_motion(config.camera, camera, distance, moving) if randomize.motion else None,
                overlays=_sample_overlays(camera, pictures, patches) if randomize.overlays else (),
                white=_sample_white(sensor) if randomize.exposure else (1.0, 1.0, 1.0),
                jpeg=int(store.integers(55, 99)) if randomize.compression else 95,
            )
        )
    return tuple(shots)


def _sample_lens(
    config: CameraConfig, targets: FloatArray, world_from_camera: FloatArray, rng: np.random.Generator
) -> Lens:
    softness, vignette = float(rng.uniform(0, 0.7)), float(rng.uniform(0, 0.4))
    if rng.uniform() >= config.focused_fraction:
        return Lens(softness, vignette)
    depths = (targets - world_from_camera[:3, 3]) @ world_from_camera[:3, 2]
    f_number = float(np.exp(rng.uniform(*np.log(config.f_number))))
    # Autofocus picks one of the objects, and errs.
    focus = max(0.1, float(rng.choice(depths) * np.exp(rng.normal(0, 0.1))))
    # Of a part of the sensor, the lens would be taken for a shorter one.
    return Lens(softness, vignette, focus, f_number / config.window)


def _sample_motion(config: CameraConfig, camera: Camera, distance: float, rng: np.random.Generator) -> Motion | None:
    """A turn and a shift of any direction, each of which moves the picture by up to `config.motion`."""
    if rng.uniform() >= config.moving_fraction:
        return None
    angle = config.motion * camera.width / camera.matrix[0, 0]
    directions = rng.normal(size=(2, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    turn, shift = directions * rng.uniform(0.05, 1, size=(2, 1)) * np.array([[angle], [angle * distance]]) / 2
    row_share = float(rng.uniform(0.1, 0.6)) if rng.uniform() < config.rolling_fraction else 1.0
    return Motion(np.concatenate((turn, shift)), row_share)


def _sample_overlays(camera: Camera, pictures: Sequence[str], rng: np.random.Generator) -> tuple[Overlay, ...]:
    """One to three patches: polygons and ellipses up to a fifth of the picture's width, or thin strips across it."""
    if rng.uniform() >= _OVERLAID:
        return ()
    return tuple(_sample_overlay(camera, pictures, rng) for _ in range(rng.integers(1, 4)))


def _sample_overlay(camera: Camera, pictures: Sequence[str], rng: np.random.Generator) -> Overlay:
    count = int(rng.choice([4, 5, 7, 32]))
    turns = np.sort(rng.uniform(0, 2 * np.pi, count)) if count < 32 else np.linspace(0, 2 * np.pi, 32, endpoint=False)
    unit = np.stack((np.cos(turns), np.sin(turns)), axis=1)
    radii = np.exp(rng.uniform(np.log(0.01), np.log(0.1), size=2)) * camera.width
    if rng.uniform() < 0.3:
        radii[0] = rng.uniform(0.2, 0.8) * camera.width
        radii[1] = rng.uniform(0.005, 0.03) * camera.width
    outline = _rotated(unit * radii, rng.uniform(0, 2 * np.pi)) + rng.uniform(0, 1, 2) * (camera.width, camera.height)
    picture = str(rng.choice(pictures)) if pictures and rng.uniform() < 0.5 else None
    return Overlay(outline, random_color(rng), picture)


def _sample_white(rng: np.random.Generator) -> tuple[float, float, float]:
    """Gains about 1: a few percent along blue to yellow, less along green to magenta."""
    warm, green = rng.normal(0, 0.06), rng.normal(0, 0.02)
    return float(np.exp(warm)), float(np.exp(green)), float(np.exp(-warm))


def _rotated(points: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])
