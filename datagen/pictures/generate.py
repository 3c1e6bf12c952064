"""One scene from its number to labelled files: sample, render, label, write; what is there already is kept."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from datagen.config import DatagenConfig
from datagen.pictures.annotate import annotate
from datagen.pictures.manifest import manifest_path, read_manifest, write_manifest
from datagen.pictures.overlay import overlaid
from datagen.pictures.photo import develop
from datagen.pictures.renderer import BlenderRenderer, Passes
from datagen.processes import lock
from datagen.scenes.sample import sample_scene
from datagen.scenes.spec import SceneSpec
from datagen.scenes.stock import Stock, load_stock
from multicam.dataset.bop_writer import LabelledImage, SceneWriter
from multicam.geometry import se3

_PATIENCE = 20.0
"""Seconds to wait for a scene that another process has; one that was killed may need some to be gone."""


class SceneMaker:
    """Makes scenes one after the other; its Blender starts when the first picture is missing. A context manager."""

    def __init__(self, config: DatagenConfig, threads: int = 0) -> None:
        """`threads` of 0 takes all cores.

        Raises:
            DataError: the models do not fit.
            MissingDependencyError: bpy is not installed.
        """
        self._config = config
        self._stock = load_stock(config.models)
        self._blender = BlenderRenderer(config.models, config.samples, threads)
        self._started = ExitStack()
        self._running = False

    def __enter__(self) -> SceneMaker:
        return self

    def __exit__(self, *_: object) -> None:
        self._started.close()

    @property
    def memory(self) -> int:
        """Bytes of RAM that Blender holds."""
        return self._blender.memory if self._running else 0

    def make(self, index: int) -> Iterator[int]:
        """Makes what is missing of scene `index`; yields the number of each picture that is safely on disk.

        Nothing but the configuration and `index` decides what is in the files. A scene that is whole has a manifest
        and is left alone.

        Raises:
            DataError: labels disagree with the render, or another process has the scene.
            RendererDied: Blender ended.
            MissingDependencyError: Blender cannot start.
        """
        folder = scene_folder(self._config, index)
        if is_finished(self._config, index):
            return
        hold = folder / ".lock"
        with lock(hold, _PATIENCE):
            writer = SceneWriter(folder)
            writer.tidy()
            # A manifest of fewer pictures is no longer true.
            manifest_path(folder).unlink(missing_ok=True)
            missing = missing_images(self._config, index)
            if missing:
                settle = self._settle if self._config.objects.settle else None
                scene = sample_scene(self._config, self._stock, index, settle)
                for im_id, passes in zip(missing, self._render(scene, missing), strict=True):
                    writer.add(im_id, label(scene, im_id, passes, self._stock))
                    yield im_id
            write_manifest(folder, self._config, index)
            # Another run may have waited for it, and have found the scene whole.
            hold.unlink(missing_ok=True)

    def _render(self, scene: SceneSpec, shots: list[int]) -> Iterator[Passes]:
        yield from self._start().render(scene, shots)

    def _settle(self, scene: SceneSpec) -> SceneSpec:
        return self._start().settle(scene)

    def _start(self) -> BlenderRenderer:
        if not self._running:
            self._started.enter_context(self._blender)
            self._running = True
        return self._blender


def render_scene(config: DatagenConfig, index: int) -> None:
    """Makes what is missing of scene `index`, with a Blender of its own; see `SceneMaker.make`."""
    with SceneMaker(config) as maker:
        for _ in maker.make(index):
            pass


def scene_folder(config: DatagenConfig, index: int) -> Path:
    """Where scene `index` is."""
    return config.output / config.split / f"{index:06d}"


def is_finished(config: DatagenConfig, index: int) -> bool:
    """Whether scene `index` is whole; its manifest says so, and no label is read."""
    manifest = read_manifest(scene_folder(config, index))
    return manifest is not None and manifest.images >= config.images_in_scene(index)


def missing_images(config: DatagenConfig, index: int) -> list[int]:
    """Pictures that scene `index` lacks; none where only the manifest is missing."""
    done = SceneWriter(scene_folder(config, index)).completed
    return [im_id for im_id in range(config.images_in_scene(index)) if im_id not in done]


def label(scene: SceneSpec, shot: int, passes: Passes, stock: Stock) -> LabelledImage:
    """Passes of one shot as a picture with its labels.

    Raises:
        DataError: render and geometry disagree.
    """
    taken = scene.shots[shot]
    passes = overlaid(passes, taken.overlays)
    noise = np.random.default_rng((scene.seed, shot))
    return LabelledImage(
        camera=taken.camera,
        camera_from_world=se3.inverse(taken.world_from_camera),
        image=develop(passes.color, taken, noise),
        depth=np.where(passes.depth < _DEPTH_LIMIT, passes.depth, np.float32(0)),
        instances=annotate(passes, scene, shot, stock.catalogue, stock.meshes),
        alpha=passes.alpha,
        jpeg_quality=taken.jpeg,
    )


_DEPTH_LIMIT = 6.5
"""Metres; a 16-bit depth image in tenths of a millimetre ends here."""
