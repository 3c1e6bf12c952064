"""Writes examples/register: two groups of three views with noisy single-view estimates of invented objects.

The files are what a user of `multicam register` brings: models_info.json, scene_camera.json, estimates.csv and
groups.json, all in BOP's formats. Run from the root of a checkout: `python -m scripts.make_register_example`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from multicam.dataset.bop_writer import pose_row, write_models
from multicam.dataset.results import write_results
from multicam.files import write_json
from multicam.geometry import se3
from multicam.types import ObjectEstimate
from tests.toy_objects import toy_catalogue, toy_meshes
from tests.toy_world import ToyWorld, make_world

FOLDER = Path("examples/register")
SCENES = (1, 2)
ROTATION_NOISE, TRANSLATION_NOISE = 0.03, 0.006
"""Standard deviations per axis of the estimates, rad and m: a fair detector at a metre."""


def main() -> None:
    """Writes every file anew; the same seeds give the same bytes."""
    write_models(FOLDER / "models", toy_catalogue(), toy_meshes())
    rows = [row for scene_id in SCENES for row in write_scene(scene_id)]
    write_results(FOLDER / "estimates.csv", rows)
    groups = [{"group_id": i, "scene_id": s, "im_ids": [0, 1, 2]} for i, s in enumerate(SCENES)]
    write_json(FOLDER / "groups.json", {"n_views": 3, "seed": 0, "groups": groups}, indent=1)


def write_scene(scene_id: int) -> list[tuple[int, int, ObjectEstimate, float]]:
    """Writes the truth of one scene and returns its estimates as rows of a results file."""
    rng = np.random.default_rng(scene_id)
    world = make_world(rng)
    folder = FOLDER / "test" / f"{scene_id:06d}"
    cameras = {
        str(i): {"cam_K": c.camera.matrix.reshape(-1).tolist(), **pose_row(se3.inverse(c.world_from_camera), "w2c")}
        for i, c in enumerate(world.cameras)
    }
    write_json(folder / "scene_camera.json", cameras, indent=1)
    write_json(folder / "scene_gt.json", {str(i): truth_rows(world, i) for i in range(len(world.cameras))}, indent=1)
    views = world.views(rng, ROTATION_NOISE, TRANSLATION_NOISE, outlier_fraction=0.1, with_detections=False)
    return [(scene_id, im_id, estimate, -1.0) for im_id, view in enumerate(views) for estimate in view.estimates]


def truth_rows(world: ToyWorld, index: int) -> list[dict[str, object]]:
    """True poses of all objects in one view."""
    camera_from_world = se3.inverse(world.cameras[index].world_from_camera)
    return [{"obj_id": o.obj_id, **pose_row(camera_from_world @ o.world_from_object, "m2c")} for o in world.objects]


if __name__ == "__main__":
    main()
