"""BlenderProc's side of datagen_speed.py; runs in an interpreter that has BlenderProc, with Blender 4.5 as bpy.

Reads one JSON request a line, {"scene": SceneSpec, "output": folder}, and answers {"output": folder} once the pictures
are rendered, loaded and written. The scene itself is built by our Builder, so both sides show the very same things; how
it is rendered and written is BlenderProc's, with its defaults. Arguments: models folder, samples, and how many of our
differences to bring in: importance map of the environment, fixed samples, denoiser in Cycles. They stay as they are,
since changing the passes between renders corrupts Blender's memory.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

os.environ["USE_EXTERNAL_BPY_MODULE"] = "1"
# Blender and BlenderProc talk on stdout, from their import on.
ANSWERS = os.fdopen(os.dup(1), "w")
os.dup2(os.open(os.devnull, os.O_WRONLY), 1)

import blenderproc as bproc
import bpy
import numpy as np
from blenderproc.python.types.MeshObjectUtility import MeshObject

from datagen.blender.build import Builder
from datagen.scenes.spec import SceneSpec, scene_from_plain
from multicam.dataset.objects import load_catalogue


def main() -> None:
    models, samples, lean = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    catalogue = load_catalogue(models)
    builder = Builder({obj_id: catalogue[obj_id].load_mesh() for obj_id in catalogue.obj_ids})
    scene = bpy.context.scene
    scene.world.use_nodes = True
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    bproc.init(clean_up_scene=False)
    bproc.renderer.set_max_amount_of_samples(samples)
    if lean > 1:
        bproc.renderer.set_noise_threshold(0)
    if lean > 2:
        bproc.renderer.set_denoiser(None)
        scene.cycles.use_denoising, scene.cycles.denoiser = True, "OPENIMAGEDENOISE"
        scene.cycles.denoising_input_passes, scene.cycles.denoising_prefilter = "RGB_ALBEDO_NORMAL", "FAST"
        bpy.context.view_layer.cycles.use_denoising = True
    bproc.renderer.enable_depth_output(activate_antialiasing=False)
    bproc.renderer.enable_segmentation_output(map_by=["instance"], default_values={"category_id": 0})
    print("{}", file=ANSWERS, flush=True)
    while line := sys.stdin.readline():
        request: dict[str, Any] = json.loads(line)
        builder.build(spec := scene_from_plain(request["scene"]))
        # Ours fixes the map; BlenderProc leaves it to Blender.
        scene.world.cycles.sampling_method = "MANUAL" if lean > 0 else "AUTOMATIC"
        render(spec, request["output"])
        print(json.dumps({"output": request["output"]}), file=ANSWERS, flush=True)


def render(spec: SceneSpec, output: str) -> None:
    bproc.utility.reset_keyframes()
    camera = spec.shots[0].camera
    bproc.camera.set_intrinsics_from_K_matrix(camera.matrix, camera.width, camera.height)
    for shot in spec.shots:
        bproc.camera.add_camera_pose(shot.world_from_camera @ np.diag([1.0, -1, -1, 1]))
    for thing in bpy.data.objects:
        if thing.type == "MESH":
            thing["category_id"] = 0
    objects = []
    for index, item in enumerate(spec.objects):
        thing = bpy.data.objects[f"instance {index}"]
        thing["category_id"] = item.obj_id
        objects.append(MeshObject(thing))
    data = bproc.renderer.render()
    bproc.writer.write_bop(
        output, objects, depths=data["depth"], colors=data["colors"], color_file_format="JPEG", depth_scale=0.1,
        # Masks and visible shares need a download; ours makes them and BlenderProc is spared.
        calc_mask_info_coco=False,
    )  # fmt: skip


if __name__ == "__main__":
    main()
