"""Takes the pictures: Cycles on the CPU, colour, depth and object index out of one render."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from datagen.blender.axes import SENSOR_MM, lens_of, world_from_blender_camera
from datagen.scenes.spec import Shot

_CHANNELS = ("Combined.R", "Combined.G", "Combined.B", "Depth.Z", "IndexOB.X")
_BEYOND = 1e9
"""Cycles writes 1e10 where a ray meets nothing."""

Pixels = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint16]]
"""Colour, depth and index of a picture."""


class Renderer:
    """Render settings, fixed once: changing passes between renders with persistent data corrupts the heap."""

    def __init__(self, samples: int, folder: Path) -> None:
        scene = bpy.context.scene
        scene.render.engine = "CYCLES"
        cycles = scene.cycles
        cycles.device, cycles.samples, cycles.use_adaptive_sampling = "CPU", samples, False
        cycles.use_denoising, cycles.denoiser = True, "OPENIMAGEDENOISE"
        cycles.denoising_input_passes, cycles.denoising_prefilter = "RGB_ALBEDO_NORMAL", "FAST"
        cycles.max_bounces, cycles.sample_clamp_indirect = 4, 4.0
        cycles.caustics_reflective = cycles.caustics_refractive = False
        scene.render.use_persistent_data = True
        scene.render.resolution_percentage = 100
        scene.render.use_file_extension = False
        scene.render.use_compositing = scene.render.use_sequencer = False
        layer = scene.view_layers[0]
        layer.use_pass_combined = layer.use_pass_z = layer.use_pass_object_index = True
        settings = scene.render.image_settings
        settings.file_format, settings.color_depth, settings.exr_codec = "OPEN_EXR_MULTILAYER", "32", "NONE"
        data = bpy.data.cameras.new("camera")
        data.sensor_width, data.sensor_fit = SENSOR_MM, "AUTO"
        data.clip_start, data.clip_end = 0.01, 100.0
        scene.camera = bpy.data.objects.new("camera", data)
        scene.collection.objects.link(scene.camera)
        self._file = folder / "render.exr"

    def render(self, shot: Shot, seed: int) -> Pixels:
        """Linear colour (h, w, 3) float32, depth (h, w) float32 metres (0: nothing), index (h, w) uint16."""
        scene = bpy.context.scene
        lens = lens_of(shot.camera)
        scene.camera.data.lens = lens.focal_mm
        scene.camera.data.shift_x, scene.camera.data.shift_y = lens.shift_x, lens.shift_y
        scene.camera.matrix_world = Matrix(world_from_blender_camera(shot.world_from_camera))
        scene.render.resolution_x, scene.render.resolution_y = shot.camera.width, shot.camera.height
        scene.cycles.seed = seed
        scene.render.filepath = str(self._file)
        bpy.ops.render.render(write_still=True)
        return _read_passes(self._file)


def _read_passes(path: Path) -> Pixels:
    packages = Path(bpy.utils.resource_path("LOCAL")) / "python" / "lib" / "python3.11" / "site-packages"
    if str(packages) not in sys.path:
        sys.path.append(str(packages))
    import OpenImageIO  # comes inside the bpy wheel

    source = OpenImageIO.ImageInput.open(str(path))
    names = list(source.spec().channelnames)
    pixels = np.asarray(source.read_image("float"))
    source.close()
    red, green, blue, z, index = (
        pixels[..., next(i for i, name in enumerate(names) if name.endswith(wanted))] for wanted in _CHANNELS
    )
    color = np.stack((red, green, blue), axis=-1)
    return color, np.where(z < _BEYOND, z, 0).astype(np.float32), np.rint(index).astype(np.uint16)
