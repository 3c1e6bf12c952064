"""Time of following one object in one picture, and how far it ends from the truth, on real RGB-D frames.

    python benchmarks/bundle_speed.py [--bench DIR]

DIR (default: $MULTICAM_BENCH, or shared/bench beside the checkout) holds ycbv_rgbd and ycbv/models. Each object starts
from its true pose moved by 10 mm and 5 degrees. M3T, in C++, takes 0.85 ms for 7 x 2 iterations of region and
depth, 0.65 of region, 0.13 of depth. CPU time is given too, for it does not count what else the machine does.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from registration import default_bench, machine
from rich.console import Console
from rich.table import Table
from scipy.spatial import KDTree

from multicam.bundle.depth.config import DepthConfig
from multicam.bundle.depth_image import DepthImage
from multicam.bundle.occlusion import Occluders
from multicam.bundle.region.config import RegionConfig
from multicam.bundle.tracking import Sight, TrackingConfig, first_colors, track
from multicam.bundle.viewpoints.cache import load_viewpoints
from multicam.bundle.viewpoints.generate import ViewpointConfig
from multicam.bundle.viewpoints.model import ViewpointModel
from multicam.dataset.bop_reader import list_scenes, read_depth, read_image, read_scene
from multicam.evaluation.pose_error import add_s
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh, load_mesh
from multicam.progress import RichProgress
from multicam.types import FloatArray

START_METRES, START_RADIANS = 0.010, np.radians(5)
DRAWS = 10
REGION = RegionConfig(scales=(7, 4, 2), deviations=(25.0, 15.0, 10.0))
DEPTH = DepthConfig(radii=(0.07, 0.05, 0.04))
BOTH = TrackingConfig(region=REGION, depth=DEPTH, searches=7)
METHODS = {
    "region and depth, 7 x 2": BOTH,
    "region, 7 x 2": replace(BOTH, depth=None),
    "depth, 7 x 2": replace(BOTH, region=None),
    "region and depth, 1 x 2": replace(BOTH, searches=1),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bench", type=Path, default=default_bench())
    options = parser.parse_args()
    print(machine())
    views = [view for scene in list_scenes(options.bench / "ycbv_rgbd" / "test") for view in seen(scene)]
    meshes = {obj: load_mesh(options.bench / f"ycbv/models/obj_{obj:06d}.glb", 1.0) for _, obj, _ in views}
    models = load_viewpoints(meshes, ViewpointConfig(), RichProgress())
    table = Table(
        "method", "ms", "CPU ms", "ADD-S mm", "below 3 mm %", title=f"{len(views)} objects, {DRAWS} starts each"
    )
    for name, config in METHODS.items():
        wall, cpu, errors = run(views, meshes, models, config)
        figures = (np.median(wall) * 1e3, np.mean(cpu) * 1e3, np.median(errors) * 1e3, np.mean(errors < 0.003) * 100)
        table.add_row(name, *(f"{figure:.2f}" for figure in figures))
    Console(width=120).print(table)


def seen(scene: Path) -> list[tuple[Sight, int, FloatArray]]:
    """Sight, class and camera_from_object of every object in every frame."""
    found: list[tuple[Sight, int, FloatArray]] = []
    for record in read_scene(scene):
        image, depth = read_image(record.rgb_path), read_depth(record.depth_path, record.depth_scale)
        camera = Camera(record.camera_matrix, image.shape[1], image.shape[0])
        measured = DepthImage(depth, camera, np.eye(4))
        sight = Sight(image, camera, np.eye(4), measured, Occluders((measured,)))
        found += [(sight, each.obj_id, each.camera_from_object) for each in record.instances]
    return found


def run(
    views: list[tuple[Sight, int, FloatArray]],
    meshes: dict[int, Mesh],
    models: dict[int, ViewpointModel],
    config: TrackingConfig,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Seconds, CPU seconds and ADD-S of each start."""
    rng = np.random.default_rng(0)
    rows: list[tuple[float, float, float]] = []
    for sight, obj, truth in views:
        vertices = meshes[obj].vertices
        points = vertices[rng.choice(len(vertices), min(len(vertices), 1000), replace=False)]
        tree = KDTree(points)
        for _ in range(DRAWS):
            start = moved(truth, rng)
            colors = first_colors(models[obj], sight, start, REGION)
            track(models[obj], [sight], [colors], start, config)
            wall, cpu = time.perf_counter(), time.process_time()
            pose = track(models[obj], [sight], [colors], start, config).world_from_object
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            rows.append((wall, cpu, add_s(pose, truth, points, tree)))
    columns = np.array(rows).T
    return columns[0], columns[1], columns[2]


def moved(pose: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A pose 10 mm and 5 degrees away, in a random direction about a random axis."""
    direction, axis = rng.normal(size=(2, 3))
    twist = np.concatenate((START_RADIANS * axis / np.linalg.norm(axis), np.zeros(3)))
    away = se3.plus(pose, twist)
    away[:3, 3] += START_METRES * direction / np.linalg.norm(direction)
    return away


if __name__ == "__main__":
    main()
