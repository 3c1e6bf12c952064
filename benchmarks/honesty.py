"""Registration of estimates with known noise, in simulation: are error bars right, and what does learning bring?

    OMP_NUM_THREADS=1 python benchmarks/honesty.py [--seeds 2] [--only NAME]

Each row is a data set of its own: classes of boxes, some symmetric, each with its own noise as a multiple of what the
geometric model expects. Errors are heavy-tailed, have half their variance (or a third) in common with those of the same
class from like directions, and some are gross; in one set half of the objects are moved between views. The noise is
learnt from the estimates of all groups, as `multicam register` does, or the geometric model is taken at its word.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from registration import machine
from rich.console import Console
from rich.table import Table

from multicam.dataset.objects import Catalogue, ObjectModel
from multicam.geometry import se3, so3
from multicam.geometry.symmetry import Axis, Symmetries
from multicam.matching.learned import NoiseModel, centre_in_camera, viewing_axes
from multicam.matching.noise import NoiseConfig, geometric_covariance
from multicam.progress import RichProgress
from multicam.registration import LearningConfig, RegistrationConfig, learn_noise, register_views
from multicam.types import FloatArray, ObjectEstimate, View

FOCAL = 600.0
MATRIX = np.array([[FOCAL, 0, 320], [0, FOCAL, 240], [0, 0, 1]])
MISSED = 0.2
TAIL = 5.0
"""Degrees of freedom of the errors."""

CHI_SQUARE_95 = 12.59


@dataclass(frozen=True)
class Scenario:
    """One simulated data set.

    Attributes:
        noise: errors as a multiple of what the geometric model expects, median of the classes.
        common: share of their variance that like views have in common.
        gross: share of gross errors.
        moved: share of objects that stand elsewhere in each further view.
        size: least and greatest edge of the boxes, metres.
        symmetric: share of symmetric classes.
        twice: several objects of one class in a scene.
        distance: of the cameras, metres.
    """

    views: int
    objects: int
    groups: int
    noise: float
    common: float = 0.5
    gross: float = 0.03
    moved: float = 0.0
    size: tuple[float, float] = (0.05, 0.2)
    symmetric: float = 0.2
    twice: bool = False
    distance: tuple[float, float] = (0.7, 1.1)
    classes: int = 12


SCENARIOS = {
    "three views": Scenario(views=3, objects=5, groups=80, noise=0.7),
    "eight views": Scenario(views=8, objects=5, groups=30, noise=0.7),
    "weak estimates, five views": Scenario(views=5, objects=5, groups=80, noise=2.3, common=0.3, gross=0.15),
    "small symmetric parts, four views": Scenario(
        views=4, objects=6, groups=80, noise=0.8, common=0.4, gross=0.05, size=(0.03, 0.09), symmetric=0.7, twice=True,
        classes=15,
    ),
    "half of the objects moved": Scenario(
        views=3, objects=6, groups=80, noise=1.2, common=0.4, gross=0.05, moved=0.5
    ),
}  # fmt: skip


class LikeErrors:
    """Errors of unit variance that vary with the direction of view, over about 35 degrees."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._centre = directions(rng, 40)
        self._weight = rng.normal(size=(40, 6))
        self._scale = np.ones(6)
        self._scale = np.sqrt(np.mean([self(d) ** 2 for d in directions(rng, 500)], axis=0))

    def __call__(self, direction: FloatArray) -> FloatArray:
        """(6,) from a direction (3,)."""
        near = np.exp((self._centre @ direction - 1) / np.radians(35) ** 2)
        return near @ self._weight / self._scale


@dataclass(frozen=True, eq=False)
class World:
    """What the classes of a simulated data set are like; `factor` is the noise of attitude, lateral place and depth."""

    scenario: Scenario
    catalogue: Catalogue
    factor: dict[int, FloatArray]
    errors: dict[int, LikeErrors]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2, help="data sets of each kind (default: 2)")
    parser.add_argument("--only", default="", help="kinds whose name contains this")
    options = parser.parse_args()
    print(machine())
    table = Table(
        "simulated set", "noise", "placed %", "mean mm / deg", "good %", "false %", "in 95 % bars",
        title="Registration with known noise",
    )  # fmt: skip
    names = [name for name in SCENARIOS if options.only in name]
    for name in RichProgress().track(names, "registering", len(names)):
        rows: dict[str, list[list[float]]] = {"as modelled": [], "learnt": []}
        for seed in range(options.seeds):
            rng = np.random.default_rng(seed)
            world = make_world(SCENARIOS[name], rng)
            scenes = [scene(world, rng) for _ in range(SCENARIOS[name].groups)]
            config = RegistrationConfig()
            learnt = learn_noise([views for _, views in scenes], world.catalogue, config, LearningConfig())
            rows["as modelled"].append(score(scenes, world.catalogue, config, None))
            rows["learnt"].append(score(scenes, world.catalogue, config, learnt))
        for kind, figures in rows.items():
            placed, mm, deg, good, false, inside = np.mean(figures, axis=0)
            table.add_row(
                name if kind == "as modelled" else "", kind, f"{placed:.1f}", f"{mm:.1f} / {deg:.2f}", f"{good:.1f}",
                f"{false:.1f}", f"{inside:.0f}",
            )  # fmt: skip
    Console(width=170).print(table)


def make_world(scenario: Scenario, rng: np.random.Generator) -> World:
    models = {n: box(n, scenario, rng) for n in range(1, scenario.classes + 1)}
    factor = {n: scenario.noise * np.exp(0.35 * rng.normal(size=3)) for n in models}
    return World(scenario, Catalogue(models), factor, {n: LikeErrors(rng) for n in models})


def box(number: int, scenario: Scenario, rng: np.random.Generator) -> ObjectModel:
    half = rng.uniform(*scenario.size, size=3) / 2
    kinds = (
        Symmetries(axes=(Axis(np.array([0, 0, 1.0])),)),
        Symmetries(se3.from_parts(so3.exp(np.pi * np.eye(3)[2:]), np.zeros((1, 3)))),
        Symmetries(se3.from_parts(so3.exp(np.pi * np.eye(3)), np.zeros((3, 3)))),
    )
    symmetries = kinds[rng.integers(3)] if rng.uniform() < scenario.symmetric else Symmetries()
    return ObjectModel(number, f"box {number}", 2 * float(np.linalg.norm(half)), symmetries, np.stack((-half, half)))


def scene(world: World, rng: np.random.Generator) -> tuple[list[FloatArray], list[View]]:
    """True world_from_camera and what each camera makes of the objects."""
    scenario = world.scenario
    chosen = rng.choice(list(world.catalogue.obj_ids), scenario.objects, replace=scenario.twice)
    places: list[FloatArray] = []
    while len(places) < len(chosen):
        spot = rng.uniform(-0.25, 0.25, 2)
        # A crowded table takes what does not quite fit.
        if all(np.linalg.norm(spot - p[:2]) > 0.7 * scenario.size[1] for p in places) or rng.uniform() < 0.02:
            places.append(np.array([*spot, 0.05]))
    objects = [(int(o), se3.from_parts(so3.random(rng), place)) for o, place in zip(chosen, places, strict=True)]
    cameras = [camera(scenario, rng) for _ in range(scenario.views)]
    views: list[View] = []
    for number, pose in enumerate(cameras):
        seen: list[ObjectEstimate] = []
        for obj_id, world_from_object in objects:
            if rng.uniform() < MISSED:
                continue
            where = world_from_object
            if number and rng.uniform() < scenario.moved:
                shift = rng.normal(size=3) * [0.12, 0.12, 0.01]
                where = se3.from_parts(so3.random(rng), where[:3, 3] + shift)
            seen.append(ObjectEstimate(obj_id, 1.0, estimate(world, obj_id, se3.inverse(pose) @ where, rng)))
        views.append(View(str(number), tuple(seen), MATRIX))
    return cameras, views


def camera(scenario: Scenario, rng: np.random.Generator) -> FloatArray:
    """world_from_camera of one that looks at about the middle of the table."""
    azimuth, elevation, distance = rng.uniform(-1.7, 1.7), rng.uniform(0.3, 1.2), rng.uniform(*scenario.distance)
    outward = np.array([np.sin(azimuth) * np.cos(elevation), -np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])
    towards = rng.normal(scale=0.05, size=3) - distance * outward
    towards /= np.linalg.norm(towards)
    right = np.cross(towards, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    pose = se3.from_parts(np.stack((right, np.cross(towards, right), towards), axis=-1), distance * outward)
    return pose @ se3.from_parts(so3.exp(np.array([0, 0, 0.2 * rng.normal()])), np.zeros(3))


def estimate(world: World, obj_id: int, truth: FloatArray, rng: np.random.Generator) -> FloatArray:
    """camera_from_object as a network would have it."""
    scenario, model = world.scenario, world.catalogue[obj_id]
    corners = model.box_corners()
    centre = corners.mean(axis=0)[None]
    expected = geometric_covariance(truth[None], corners[None], np.array([FOCAL]), NoiseConfig())[0]
    axes = viewing_axes(truth[None], centre)[0]
    ray = centre_in_camera(truth[None], centre)[0]
    direction = truth[:3, :3].T @ ray / np.linalg.norm(ray)
    own = rng.normal(size=6) * np.sqrt((TAIL - 2) / rng.chisquare(TAIL))
    draw = np.sqrt(scenario.common) * world.errors[obj_id](direction) + np.sqrt(1 - scenario.common) * own
    deviation = np.repeat(world.factor[obj_id], (3, 2, 1)) * (np.linalg.cholesky(axes @ expected @ axes.T) @ draw)
    pose = se3.plus(truth, np.linalg.solve(axes, deviation))
    if rng.uniform() < scenario.gross:
        wild = rng.uniform() < 0.5
        turn = so3.random(rng) if wild else pose[:3, :3] @ so3.exp(0.5 * rng.normal(size=3))
        pose = se3.from_parts(turn, pose[:3, 3] * [1, 1, np.exp(0.1 * rng.normal())])
    if model.symmetries.axes:
        return pose @ model.symmetries.axes[0].rotation(np.asarray(rng.uniform(0, 2 * np.pi)))
    twins = np.concatenate((np.eye(4)[None], model.symmetries.discrete))
    return pose @ twins[rng.integers(len(twins))]


def score(
    scenes: list[tuple[list[FloatArray], list[View]]],
    catalogue: Catalogue,
    config: RegistrationConfig,
    noise: NoiseModel | None,
) -> list[float]:
    """Placed %, mean mm and deg of the placed, good % of all, false % of the placed pairs, % inside the 95 % bars."""
    errors: list[tuple[float, float]] = []
    inside: list[bool] = []
    pairs = 0
    for truth, views in scenes:
        pairs += len(views) * (len(views) - 1) // 2
        for component in register_views(views, catalogue, config, noise).components:
            for n, second in enumerate(component.cameras):
                for first in component.cameras[:n]:
                    found = se3.inverse(first.world_from_camera) @ second.world_from_camera
                    true = se3.inverse(truth[int(first.view_id)]) @ truth[int(second.view_id)]
                    turn = float(np.degrees(np.linalg.norm(se3.minus(found, true)[:3])))
                    errors.append((1000 * float(np.linalg.norm((found - true)[:3, 3])), turn))
                    if first is component.cameras[0]:
                        twist = se3.minus(true, found)
                        inside.append(bool(twist @ np.linalg.solve(second.covariance, twist) < CHI_SQUARE_95))
    mm, deg = np.array(errors).T
    good, false = np.sum((mm < 50) & (deg < 5)) / pairs, np.mean((mm > 100) | (deg > 10))
    shares = (len(errors) / pairs, good, false, np.mean(inside))
    placed, good, false, within = (100 * float(share) for share in shares)
    return [placed, float(mm.mean()), float(deg.mean()), good, false, within]


def directions(rng: np.random.Generator, count: int) -> FloatArray:
    """(count, 3) unit vectors."""
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


if __name__ == "__main__":
    main()
