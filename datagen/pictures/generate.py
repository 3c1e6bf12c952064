"""Plan, render, label, write; a killed run continues with the first picture that is missing."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from datagen.config import DatagenConfig
from datagen.pictures.annotate import annotate
from datagen.pictures.output import claim, copy_models
from datagen.pictures.photo import develop
from datagen.pictures.renderer import BlenderRenderer, Passes
from datagen.scenes.sample import sample_scene
from datagen.scenes.spec import SceneSpec
from datagen.scenes.stock import Stock, load_stock
from multicam.dataset.bop_writer import LabelledImage, SceneWriter
from multicam.geometry import se3
from multicam.progress import Progress, SilentProgress

_log = logging.getLogger(__name__)


def generate(config: DatagenConfig, progress: Progress | None = None) -> None:
    """Renders the data set of a configuration, or what is missing of it.

    Pictures depend on the configuration alone, not on when the run was stopped or continued.

    Raises:
        DataError: the models do not fit, the folder holds another configuration's pictures, or labels disagree
            with the render.
        MissingDependencyError: Blender cannot start.
    """
    stock = load_stock(config.models)
    split = config.output / config.split
    # More pictures of the same kind may be asked for, and folders may move.
    claim(split / "config.yaml", config, free=("images", "models", "output"))
    copy_models(config.models, config.output / "models")
    plan = [(index, missing) for index in range(config.scenes) if (missing := _missing(config, split, index))]
    total = sum(len(missing) for _, missing in plan)
    _log.info("%d of %d pictures are to be rendered into %s", total, config.images, split)
    if not plan:
        return
    started = time.monotonic()
    pictures = _render(config, stock, split, plan)
    for _ in (progress or SilentProgress()).track(pictures, f"rendering {config.split}", total):
        pass
    hours = (time.monotonic() - started) / 3600
    _log.info("rendered %d pictures, %.0f an hour", total, total / hours)


def label(scene: SceneSpec, shot: int, passes: Passes, stock: Stock) -> LabelledImage:
    """Passes of one shot as a picture with its labels.

    Raises:
        DataError: render and geometry disagree.
    """
    taken = scene.shots[shot]
    noise = np.random.default_rng((scene.seed, shot))
    return LabelledImage(
        camera=taken.camera,
        camera_from_world=se3.inverse(taken.world_from_camera),
        image=develop(passes.color, taken, noise),
        depth=np.where(passes.depth < _DEPTH_LIMIT, passes.depth, np.float32(0)),
        instances=annotate(passes, scene, shot, stock.catalogue, stock.meshes),
    )


_DEPTH_LIMIT = 6.5
"""Metres; a 16-bit depth image in tenths of a millimetre ends here."""


def _missing(config: DatagenConfig, split: Path, index: int) -> list[int]:
    done = SceneWriter(_scene_folder(split, index)).completed
    return [im_id for im_id in range(config.images_in_scene(index)) if im_id not in done]


def _scene_folder(split: Path, index: int) -> Path:
    return split / f"{index:06d}"


def _render(config: DatagenConfig, stock: Stock, split: Path, plan: list[tuple[int, list[int]]]) -> Iterator[None]:
    """Yields after every picture that is safely on disk."""
    with BlenderRenderer(config.models, config.samples) as renderer:
        for index, missing in plan:
            writer = SceneWriter(_scene_folder(split, index))
            scene = sample_scene(config, stock, index)
            for im_id, passes in zip(missing, renderer.render(scene, missing), strict=True):
                writer.add(im_id, label(scene, im_id, passes, stock))
                yield
