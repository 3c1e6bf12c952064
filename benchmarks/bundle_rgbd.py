"""Poses of single views refined on real RGB-D pictures: from published estimates, and from truth moved away (YCB-V).

    python benchmarks/bundle_rgbd.py [--bench DIR] [--draws 100] [--overlays DIR] [--basin SVG]

DIR (default: $MULTICAM_BENCH, or shared/bench beside the checkout) holds ycbv_rgbd and ycbv. The camera is fixed.
Starts that are drawn lie 10 mm and 5 degrees from the truth, and their prior says so; published estimates have that of
estimates that state no noise.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from bundle_speed import moved
from registration import default_bench, machine
from rich.console import Console
from rich.table import Table
from scipy.spatial import KDTree

from multicam.bundle.adjustment.adjust import Adjusted, adjust
from multicam.bundle.adjustment.config import AdjustmentConfig
from multicam.bundle.adjustment.registered import EstimateNoise, scene_of
from multicam.bundle.adjustment.scene import Body, Picture
from multicam.bundle.depth_image import DepthImage
from multicam.bundle.viewpoints.cache import load_viewpoints
from multicam.bundle.viewpoints.generate import ViewpointConfig
from multicam.commands.candidates import read_candidates
from multicam.dataset.bop_reader import ImageRecord, list_scenes, read_depth, read_image, read_scene
from multicam.dataset.objects import Catalogue, load_catalogue
from multicam.evaluation.pose_error import add_s
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import load_mesh
from multicam.geometry.rasterizer import render_depth
from multicam.matching.noise import NoiseConfig
from multicam.progress import RichProgress
from multicam.types import Component, FloatArray, ObjectEstimate, PlacedCamera, PlacedObject, View

MOVED = np.diag(np.repeat(np.square([np.radians(5), 0.010]) / 3, 3))
"""Covariance of the starts that are drawn."""

SUCCESS = 10.0
"""Millimetres of ADD-S."""

VARIANTS = {
    "region and depth": AdjustmentConfig(),
    "region": AdjustmentConfig(depth=None, measured_occlusion=False),
    "depth": AdjustmentConfig(region=None),
    "region and depth, no occlusion": AdjustmentConfig(modelled_occlusion=False, measured_occlusion=False),
}


@dataclass(frozen=True, eq=False)
class Keyframe:
    """One picture, its truth, and the estimates of each published method for it."""

    record: ImageRecord
    picture: Picture
    estimates: dict[str, list[ObjectEstimate]]


class Bench:
    """The frames, their objects, and distances."""

    def __init__(self, folder: Path) -> None:
        self.catalogue: Catalogue = load_catalogue(folder / "ycbv")
        published = {
            path.name.split("_")[0].split("-")[0]: read_candidates(path, self.catalogue)
            for path in sorted((folder / "ycbv/results").glob("*.csv*"))
        }
        self.frames: list[Keyframe] = []
        for scene in list_scenes(folder / "ycbv_rgbd/test"):
            for record in read_scene(scene):
                image, depth = read_image(record.rgb_path), read_depth(record.depth_path, record.depth_scale)
                camera = Camera(record.camera_matrix, image.shape[1], image.shape[0])
                picture = Picture(image, camera, DepthImage(depth, camera, np.eye(4)))
                found = {name: rows.get((record.scene_id, record.im_id), []) for name, rows in published.items()}
                self.frames.append(Keyframe(record, picture, found))
        classes = sorted({each.obj_id for frame in self.frames for each in frame.record.instances})
        meshes = {o: load_mesh(folder / f"ycbv/models/obj_{o:06d}.glb", 1.0) for o in classes}
        models = load_viewpoints(meshes, ViewpointConfig(), RichProgress())
        self.bodies = {o: Body(models[o], meshes[o]) for o in classes}
        rng = np.random.default_rng(0)
        self.points = {o: mesh.sample_surface(1000, rng) for o, mesh in meshes.items()}
        self.trees = {o: KDTree(points) for o, points in self.points.items()}

    def error(self, obj: int, found: FloatArray, truth: FloatArray) -> float:
        """ADD-S, millimetres."""
        return 1e3 * add_s(found, truth, self.points[obj], self.trees[obj])

    def refined(
        self, frame: Keyframe, estimates: list[ObjectEstimate], config: AdjustmentConfig
    ) -> tuple[Adjusted, list[FloatArray]]:
        """Adjusts the objects of one picture; the camera is the world."""
        covariance = [np.eye(6) if each.covariance is None else each.covariance for each in estimates]
        objects = tuple(
            PlacedObject(each.obj_id, 1.0, each.camera_from_object, known, (("0", n),))
            for n, (each, known) in enumerate(zip(estimates, covariance, strict=True))
        )
        component = Component((PlacedCamera("0", np.eye(4), np.zeros((6, 6))),), objects)
        views = [View("0", tuple(estimates), frame.picture.camera.matrix)]
        scene, state = scene_of(
            component, views, {"0": frame.picture}, self.bodies, self.catalogue, EstimateNoise(NoiseConfig())
        )
        answer = adjust(scene, state, config)
        return answer, list(answer.state.world_from_object)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bench", type=Path, default=default_bench())
    parser.add_argument("--draws", type=int, default=100, help="starts around the truth, spread over all objects")
    parser.add_argument("--overlays", type=Path, help="folder for pictures with contours before and after")
    parser.add_argument("--basin", type=Path, help="picture of how often starts further and further off succeed")
    options = parser.parse_args()
    print(machine())
    bench = Bench(options.bench)
    table = Table("start", "method", "n", "before mm", "after mm", "mean", "below 3 mm %", "below 6 mm %", "better %")
    for name, config in VARIANTS.items():
        for start, pairs in (
            ("10 mm, 5 deg", drawn(bench, options.draws, config)),
            *((method, published(bench, method, config)) for method in bench.frames[0].estimates),
        ):
            before, after = np.array(pairs).T
            figures = (np.median(before), np.median(after), after.mean())
            shares = (np.mean(after < 3), np.mean(after < 6), np.mean(after < before))
            table.add_row(
                start, name, str(len(after)), *(f"{x:.2f}" for x in figures), *(f"{100 * x:.0f}" for x in shares)
            )
    Console(width=140).print(table)
    if options.overlays is not None:
        options.overlays.mkdir(parents=True, exist_ok=True)
        for frame in bench.frames:
            draw(bench, frame, options.overlays)
    if options.basin is not None:
        plot_basin(bench, options.draws, options.basin)


def plot_basin(bench: Bench, draws: int, path: Path) -> None:
    """Share of starts that end within SUCCESS, over how far they were from the truth."""
    import matplotlib.pyplot as plt

    factors = (0.5, 1, 2, 3, 4, 6)
    figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
    for name in ("region and depth", "depth", "region"):
        ends = [np.array(drawn(bench, draws, VARIANTS[name], factor))[:, 1] for factor in factors]
        shares = [100 * np.mean(after < SUCCESS) for after in ends]
        axes.plot([10 * factor for factor in factors], shares, marker="o", label=name)
        print(name, *(f"{share:.0f} %" for share in shares))
    axes.set(xlabel="start: this many mm and half as many degrees off", ylabel=f"ADD-S below {SUCCESS:.0f} mm, %")
    axes.set(ylim=(0, 103))
    axes.legend()
    figure.savefig(path, metadata={"Date": None})


def drawn(bench: Bench, draws: int, config: AdjustmentConfig, factor: float = 1.0) -> list[tuple[float, float]]:
    """ADD-S before and after, millimetres, of starts around the truth; objects take turns.

    Args:
        factor: how much further off than 10 mm and 5 degrees they are.
    """
    rng = np.random.default_rng(0)
    seen = [(frame, each) for frame in bench.frames for each in frame.record.instances]
    pairs: list[tuple[float, float]] = []
    for n in range(draws):
        frame, each = seen[n % len(seen)]
        truth = each.camera_from_object
        away = factor * se3.minus(moved(truth, rng), truth)
        start = ObjectEstimate(each.obj_id, 1.0, se3.plus(truth, away), factor**2 * MOVED)
        _, (pose,) = bench.refined(frame, [start], config)
        pairs.append(
            tuple(bench.error(each.obj_id, p, each.camera_from_object) for p in (start.camera_from_object, pose))
        )
    return pairs


def published(bench: Bench, method: str, config: AdjustmentConfig) -> list[tuple[float, float]]:
    """The same of the estimates of a published method, all objects of a picture at once."""
    pairs: list[tuple[float, float]] = []
    for frame in bench.frames:
        truth = {each.obj_id: each.camera_from_object for each in frame.record.instances}
        starts = [each for each in frame.estimates[method] if each.obj_id in truth]
        if not starts:
            continue
        _, poses = bench.refined(frame, starts, config)
        for start, pose in zip(starts, poses, strict=True):
            both = (start.camera_from_object, pose)
            pairs.append(tuple(bench.error(start.obj_id, p, truth[start.obj_id]) for p in both))
    return pairs


def draw(bench: Bench, frame: Keyframe, folder: Path) -> None:
    """Contours of the first method's estimates (red) and of what they become (green), twice as large."""
    starts = [each for each in next(iter(frame.estimates.values())) if each.obj_id in bench.bodies]
    _, poses = bench.refined(frame, starts, AdjustmentConfig())
    camera, picture = frame.picture.camera.scaled(2), cv2.cvtColor(frame.picture.image, cv2.COLOR_RGB2BGR)
    picture = cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
    for start, pose in zip(starts, poses, strict=True):
        for each, color in ((start.camera_from_object, (0, 0, 255)), (pose, (0, 255, 0))):
            mask = (render_depth(bench.bodies[start.obj_id].mesh, camera, each) > 0).astype(np.uint8)
            contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(picture, contours, -1, color, 1)
    cv2.imwrite(str(folder / f"{frame.record.scene_id:06d}_{frame.record.im_id:06d}.png"), picture)


if __name__ == "__main__":
    main()
