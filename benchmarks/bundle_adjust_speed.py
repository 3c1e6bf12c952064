"""Time of adjusting three cameras that all see nine objects, with and without depth.

    python benchmarks/bundle_adjust_speed.py RECORDING [--profile]

RECORDING gives nine meshes; they are laid out before the cameras, and their pictures are drawn. CPU time
is given too, for it does not count what else the machine does.
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from registration import machine

from multicam.bundle.adjustment.adjust import adjust
from multicam.bundle.adjustment.config import AdjustmentConfig
from multicam.bundle.adjustment.scene import Body, Picture, Scene
from multicam.bundle.depth_image import draw_bodies
from multicam.bundle.problem import State
from multicam.bundle.viewpoints.cache import load_viewpoints
from multicam.bundle.viewpoints.generate import ViewpointConfig
from multicam.dataset.sequence import load_recording
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import load_mesh
from multicam.progress import RichProgress

STD = np.repeat([0.03, 0.005], 3)
REPEATS = 10


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--profile", action="store_true")
    options = parser.parse_args()
    print(machine())
    scene, start = laid_out(options.recording)
    flat = replace(scene, pictures=[replace(each, depth=None) for each in scene.pictures])
    config = AdjustmentConfig()
    for name, each, how in (
        ("RGB", flat, config),
        ("RGB-D", scene, config),
        ("RGB-D, no modelled occlusion", scene, replace(config, modelled_occlusion=False)),
    ):
        adjust(each, start, how)
        wall, cpu = [], []
        for _ in range(REPEATS):
            began, used = time.perf_counter(), time.process_time()
            adjust(each, start, how)
            wall.append(time.perf_counter() - began)
            cpu.append(time.process_time() - used)
        print(f"{name}: {1e3 * np.median(wall):.0f} ms, {1e3 * np.median(cpu):.0f} CPU ms for 27 edges")
    if options.profile:
        with cProfile.Profile() as profile:
            adjust(scene, start, config)
        pstats.Stats(profile).sort_stats("tottime").print_stats(25)


def laid_out(folder: Path) -> tuple[Scene, State]:
    """Nine objects on a grid before three cameras half a metre off, 640 x 480."""
    rng = np.random.default_rng(0)
    recording = load_recording(folder)
    meshes = {o: load_mesh(folder / f"models/obj_{o:06d}.ply", 1e-3) for o in recording.catalogue.obj_ids[:9]}
    models = load_viewpoints(meshes, ViewpointConfig(), RichProgress())
    bodies = [Body(models[o], meshes[o]) for o in meshes]
    grid = np.stack(np.meshgrid([-0.12, 0, 0.12], [-0.12, 0, 0.12], [0.6]), axis=-1).reshape(-1, 3)
    objects = se3.random(rng, 9, spread=0.0)
    objects[:, :3, 3] = grid
    cameras = se3.exp(np.array([[0, 0.2 * k, 0, -0.1 * k, 0, 0] for k in (0.0, 1.0, -1.0)]))
    camera = Camera.from_focal(600.0, 640, 480)
    pictures: list[Picture] = []
    for world_from_camera in cameras:
        poses = se3.inverse(world_from_camera) @ objects
        drawn = draw_bodies([(body.mesh, pose) for body, pose in zip(bodies, poses, strict=True)], camera)
        image = np.where(np.isfinite(drawn.depth)[..., None], [160, 90, 60], [70, 90, 120])
        noisy = (image + rng.normal(scale=10, size=image.shape)).clip(0, 255).astype(np.uint8)
        pictures.append(Picture(noisy, camera, replace(drawn, depth=np.minimum(drawn.depth, np.float32(1.0)))))
    index = np.mgrid[:3, :9].reshape(2, -1)
    estimated = se3.plus(se3.inverse(cameras)[index[0]] @ objects[index[1]], rng.normal(size=(27, 6)) * STD)
    scene = Scene(
        pictures=pictures,
        bodies=bodies,
        camera=index[0],
        object=index[1],
        estimated=estimated,
        information=np.tile(np.diag(STD**-2), (27, 1, 1)),
        fixed=np.arange(3) == 0,
        camera_covariance=np.array([0.0, 1, 1])[:, None, None] * np.diag(STD**2),
        object_covariance=np.tile(np.diag(STD**2), (9, 1, 1)),
    )
    cameras = cameras.copy()
    cameras[1:] = se3.plus(cameras[1:], rng.normal(size=(2, 6)) * STD / 2)
    return scene, State(cameras, se3.plus(objects, rng.normal(size=(9, 6)) * STD / 2))


if __name__ == "__main__":
    main()
