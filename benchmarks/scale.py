"""Time of one registration as cameras and objects grow, in simulation.

    OMP_NUM_THREADS=1 python benchmarks/scale.py

Every camera sees four fifths of the objects, each of a class of its own, with the errors that the noise model expects
and three gross errors in a hundred.
"""

from __future__ import annotations

import time

import numpy as np
from registration import machine
from rich.console import Console
from rich.table import Table

from multicam.dataset.objects import Catalogue, ObjectModel
from multicam.geometry import se3, so3
from multicam.geometry.symmetry import Symmetries
from multicam.matching.noise import NoiseConfig, geometric_covariance
from multicam.registration import RegistrationConfig, register_views
from multicam.types import FloatArray, ObjectEstimate, View

SIZES = ((3, 5), (8, 12), (16, 25), (32, 50))
REPEATS = 5
FOCAL = 600.0
SEEN, GROSS = 0.8, 0.03


def main() -> None:
    print(machine())
    table = Table("cameras", "objects", "placed %", "mean mm", "median ms", "slowest ms", title="Scale")
    for cameras, objects in SIZES:
        rng = np.random.default_rng(0)
        catalogue = Catalogue({n: box(n, rng) for n in range(1, objects + 1)})
        seconds: list[float] = []
        errors: list[float] = []
        for repeat in range(REPEATS + 1):
            poses, views = scene(catalogue, cameras, rng)
            began = time.perf_counter()
            answer = register_views(views, catalogue, RegistrationConfig())
            if repeat > 0:
                # The first one compiles.
                seconds.append(time.perf_counter() - began)
                errors += [
                    1000
                    * float(
                        np.linalg.norm((se3.inverse(poses[0]) @ poses[int(c.view_id)] - c.world_from_camera)[:3, 3])
                    )
                    for component in answer.components[:1]
                    for c in component.cameras
                ]
        table.add_row(
            str(cameras), str(objects), f"{100 * len(errors) / (REPEATS * cameras):.0f}", f"{np.mean(errors):.1f}",
            f"{1000 * np.median(seconds):.0f}", f"{1000 * max(seconds):.0f}",
        )  # fmt: skip
    Console().print(table)


def box(number: int, rng: np.random.Generator) -> ObjectModel:
    half = rng.uniform(0.025, 0.06, size=3)
    return ObjectModel(number, f"box {number}", 2 * float(np.linalg.norm(half)), Symmetries(), np.stack((-half, half)))


def scene(catalogue: Catalogue, cameras: int, rng: np.random.Generator) -> tuple[list[FloatArray], list[View]]:
    """world_from_camera of cameras around a table, and what they see."""
    places = np.column_stack(
        (rng.uniform(-0.3, 0.3, size=(len(catalogue.obj_ids), 2)), np.full(len(catalogue.obj_ids), 0.05))
    )
    objects = [se3.from_parts(so3.random(rng), place) for place in places]
    poses: list[FloatArray] = []
    views: list[View] = []
    for number in range(cameras):
        azimuth, elevation = rng.uniform(0, 2 * np.pi), rng.uniform(0.4, 1.2)
        towards = -np.array(
            [np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)]
        )
        right = np.cross(towards, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        pose = se3.from_parts(np.stack((right, np.cross(towards, right), towards), axis=-1), -towards)
        poses.append(pose)
        seen: list[ObjectEstimate] = []
        for obj_id, world_from_object in zip(catalogue.obj_ids, objects, strict=True):
            if rng.uniform() > SEEN:
                continue
            truth = se3.inverse(pose) @ world_from_object
            covariance = geometric_covariance(
                truth[None], catalogue[obj_id].box_corners()[None], np.array([FOCAL]), NoiseConfig()
            )[0]
            estimate = se3.plus(truth, np.linalg.cholesky(covariance) @ rng.normal(size=6))
            if rng.uniform() < GROSS:
                estimate[:3, :3] = so3.random(rng)
            seen.append(ObjectEstimate(obj_id, 0.9, estimate))
        views.append(View(str(number), tuple(seen), np.array([[FOCAL, 0, 320], [0, FOCAL, 240], [0, 0, 1]])))
    return poses, views


if __name__ == "__main__":
    main()
