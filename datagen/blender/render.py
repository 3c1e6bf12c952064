"""Takes the pictures: Cycles on the CPU, colour, depth and object index out of one render."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from datagen.blender.axes import SENSOR_MM, lens_of, world_from_blender_camera
from datagen.scenes.spec import SENSOR_WIDTH, Motion, Shot
from multicam.geometry import se3

_BEYOND = 1e9
"""Cycles writes 1e10 where a ray meets nothing."""
_OVERLAPS = 2
"""Objects that share a pixel and are told apart there."""

Pixels = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint16], NDArray[np.float32]]
"""Colour, depth, index and alpha of a picture."""


class Renderer:
    """Render settings, fixed once: changing passes between renders with persistent data corrupts the heap."""

    def __init__(self, samples: int, threads: int) -> None:
        scene = bpy.context.scene
        if threads:
            scene.render.threads_mode, scene.render.threads = "FIXED", threads
        scene.render.engine = "CYCLES"
        cycles = scene.cycles
        cycles.device, cycles.samples, cycles.use_adaptive_sampling = "CPU", samples, False
        cycles.use_denoising, cycles.denoiser = True, "OPENIMAGEDENOISE"
        cycles.denoising_input_passes, cycles.denoising_prefilter = "RGB_ALBEDO_NORMAL", "FAST"
        cycles.max_bounces, cycles.sample_clamp_indirect = 4, 4.0
        # For scenes of many lamps; with three it costs a tenth of the time and saves no noise.
        cycles.use_light_tree = False
        cycles.caustics_reflective = cycles.caustics_refractive = False
        scene.render.use_persistent_data = True
        scene.render.resolution_percentage = 100
        scene.render.use_file_extension = False
        scene.render.use_compositing = scene.render.use_sequencer = False
        layer = scene.view_layers[0]
        layer.use_pass_combined = layer.use_pass_z = layer.use_pass_object_index = True
        layer.use_pass_cryptomatte_object, layer.pass_cryptomatte_depth = True, _OVERLAPS
        settings = scene.render.image_settings
        settings.file_format, settings.color_depth, settings.exr_codec = "OPEN_EXR_MULTILAYER", "32", "NONE"
        data = bpy.data.cameras.new("camera")
        data.sensor_width, data.sensor_fit = SENSOR_MM, "AUTO"
        data.clip_start, data.clip_end = 0.01, 100.0
        scene.camera = bpy.data.objects.new("camera", data)
        # Keyframes need quaternions; switched later, they would round poses differently and change all pixels.
        scene.camera.rotation_mode = "QUATERNION"
        scene.render.motion_blur_shutter = 1.0
        scene.collection.objects.link(scene.camera)
        # Blender wants a file by name; this one has no place on disk where a killed process could leave it.
        self._file = Path(f"/proc/self/fd/{os.memfd_create('render')}")

        self._samples = samples

    def render(self, shot: Shot, seed: int) -> Pixels:
        """Linear colour (h, w, 3) float32, depth (h, w) float32 metres (0: nothing), index (h, w) uint16, alpha.

        Depth and index are those of a pinhole in the middle of the exposure, so a picture with blur takes a second,
        much quicker render for them.
        """
        scene, lens = bpy.context.scene, lens_of(shot.camera)
        data = scene.camera.data
        data.lens, data.shift_x, data.shift_y = lens.focal_mm, lens.shift_x, lens.shift_y
        scene.render.resolution_x, scene.render.resolution_y = shot.camera.width, shot.camera.height
        scene.cycles.seed = seed
        self._aim(shot.world_from_camera)
        if shot.motion is None and not shot.lens.f_number:
            return self._take()
        with _blurred(scene, shot):
            if shot.motion is not None:
                self._sweep(shot.world_from_camera, shot.motion)
            color, _, _, alpha = self._take()
            scene.camera.animation_data_clear()
        self._aim(shot.world_from_camera)
        scene.cycles.samples, scene.cycles.use_denoising = 1, False
        _, depth, index, _ = self._take()
        scene.cycles.samples, scene.cycles.use_denoising = self._samples, True
        return color, depth, index, alpha

    def _aim(self, world_from_camera: NDArray[np.float64]) -> None:
        bpy.context.scene.camera.matrix_world = Matrix(world_from_blender_camera(world_from_camera))

    def _sweep(self, world_from_camera: NDArray[np.float64], motion: Motion) -> None:
        """Keyframes of the camera from the first to the last moment of the exposure, frame 1 being its middle."""
        scene = bpy.context.scene
        for frame, share in ((0, -1.0), (1, 0.0), (2, 1.0)):
            # The shutter is open for one frame, so from 0.5 to 1.5.
            self._aim(se3.plus(world_from_camera, share * motion.twist))
            for channel in ("location", "rotation_quaternion"):
                scene.camera.keyframe_insert(channel, frame=frame)
        for curve in scene.camera.animation_data.action.fcurves:
            for key in curve.keyframe_points:
                key.interpolation = "LINEAR"
        scene.frame_set(1)

    def _take(self) -> Pixels:
        bpy.context.scene.render.filepath = str(self._file)
        bpy.ops.render.render(write_still=True)
        return _read_passes(self._file)


@contextmanager
def _blurred(scene: Any, shot: Shot) -> Generator[None]:
    """The picture's own depth of field and shutter; afterwards again a pinhole that needs no time."""
    dof, motion = scene.camera.data.dof, shot.motion
    dof.use_dof, dof.focus_distance = shot.lens.f_number > 0, shot.lens.focus
    # Blender takes the aperture from a lens on its own, larger sensor.
    dof.aperture_fstop = max(shot.lens.f_number, 0.1) * SENSOR_MM / (1000 * SENSOR_WIDTH)
    scene.render.use_motion_blur = motion is not None
    if motion is not None:
        scene.cycles.rolling_shutter_type = "TOP" if motion.row_share < 1 else "NONE"
        scene.cycles.rolling_shutter_duration = motion.row_share
    yield
    dof.use_dof, scene.render.use_motion_blur = False, False


def _read_passes(path: Path) -> Pixels:
    packages = Path(bpy.utils.resource_path("LOCAL")) / "python" / "lib" / "python3.11" / "site-packages"
    if str(packages) not in sys.path:
        sys.path.append(str(packages))
    import OpenImageIO  # comes inside the bpy wheel

    source = OpenImageIO.ImageInput.open(str(path))
    names = list(source.spec().channelnames)
    manifest = next(a.value for a in source.spec().extra_attribs if a.name.endswith("/manifest"))
    pixels = np.asarray(source.read_image("float"))
    source.close()

    def channel(name: str) -> NDArray[np.float32]:
        return pixels[..., next(i for i, known in enumerate(names) if known.endswith(name))]

    depth = channel("Depth.Z")
    return (
        np.stack([channel(f"Combined.{c}") for c in "RGB"], axis=-1),
        np.where(depth < _BEYOND, depth, 0).astype(np.float32),
        np.rint(channel("IndexOB.X")).astype(np.uint16),
        _alpha(channel, json.loads(manifest)),
    )


def _alpha(channel: Callable[[str], NDArray[np.float32]], manifest: dict[str, str]) -> NDArray[np.float32]:
    """Share of each pixel that labelled objects cover.

    Cryptomatte (Friedman and Jones 2015) stores pairs of an object's hash, its bits taken as a float, and its share.
    """
    labelled = [int(manifest[thing.name], 16) for thing in bpy.data.objects if thing.pass_index]
    hashes = np.array(labelled, dtype=np.uint32).view(np.float32)
    alpha = np.zeros(channel("Depth.Z").shape, dtype=np.float32)
    for number, share in ("rg", "ba"):
        alpha += np.where(np.isin(channel(f"CryptoObject00.{number}"), hashes), channel(f"CryptoObject00.{share}"), 0)
    return np.clip(alpha, 0, 1)
