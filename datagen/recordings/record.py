"""Renders a recording and proves from its labels that the cameras see what they should."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from datagen.pictures.generate import label
from datagen.pictures.output import claim, copy_models
from datagen.pictures.renderer import BlenderRenderer, Passes
from datagen.recordings.board import BOARD, write_board
from datagen.recordings.config import SequenceConfig
from datagen.recordings.depth_sensor import sense_depth
from datagen.recordings.hindsight import read_sight, scene_folder
from datagen.recordings.rehearsal import sample_stage
from datagen.recordings.sight import verify_sight
from datagen.recordings.stage import BOARD_PICTURE, Stage
from datagen.recordings.tracking import tracking_errors
from datagen.scenes.stock import Stock, load_stock
from multicam.dataset.bop_writer import LabelledImage, SceneWriter
from multicam.dataset.sequence import CameraEntry, write_sequence
from multicam.progress import Progress, SilentProgress

_log = logging.getLogger(__name__)

Plan = list[tuple[CameraEntry, list[int]]]
"""Per camera the steps whose pictures are missing."""


def record(config: SequenceConfig, progress: Progress | None = None) -> None:
    """Renders the recording of a configuration, or what is missing of it; sequence.json completes it.

    Raises:
        DataError: the folder holds another recording, labels disagree with the render, or the cameras do not see
            what the recording promises.
        MissingDependencyError: Blender cannot start.
    """
    stock = load_stock(config.models)
    claim(config.output / "config.yaml", config, free=("models", "output"))
    copy_models(config.models, config.output / "models")
    stage = sample_stage(config, stock)
    if stage.board:
        write_board(config.output / BOARD_PICTURE)
    plan = [(camera, _missing(config.output, camera)) for camera in stage.cameras]
    total = sum(len(missing) for _, missing in plan)
    _log.info("%d of %d pictures are to be written into %s", total, len(stage.scene.shots), config.output)
    if total:
        pictures = _render(stock, stage, plan)
        for _ in (progress or SilentProgress()).track(pictures, "recording", total):
            pass
    verify_sight(read_sight(config.output, stage), stage)
    board = BOARD if stage.board else None
    write_sequence(config.output, stage.cameras, board, tracking_errors(config.drift), stage.truth)


def _missing(folder: Path, camera: CameraEntry) -> list[int]:
    done = SceneWriter(scene_folder(folder, camera.scene_id)).completed
    return [entry.im_id for entry in camera.frames if entry.im_id not in done]


def _render(stock: Stock, stage: Stage, plan: Plan) -> Iterator[None]:
    """Yields after every picture that is safely on disk.

    Pictures that differ by the noise of the sensors alone are rendered once: a static camera's is rendered again only
    when it was bumped or something that it sees moved.
    """
    config = stage.config
    with BlenderRenderer(config.models, config.samples) as renderer:
        for camera, missing in plan:
            writer = SceneWriter(scene_folder(config.output, camera.scene_id))
            writer.tidy()
            needed = [stage.rendered_as[stage.shot_of(camera, step)] for step in missing]
            rendered = renderer.render(stage.scene, sorted(set(needed)))
            last, passes = -1, None
            for step, shot in zip(missing, needed, strict=True):
                if shot != last:
                    last, passes = shot, next(rendered)
                assert passes is not None
                writer.add(step, _picture(stage, camera, step, passes, stock))
                yield


def _picture(stage: Stage, camera: CameraEntry, step: int, passes: Passes, stock: Stock) -> LabelledImage:
    """The picture with its labels, and with the depth that the camera's sensor gives.

    Exact depth is not stored: it would tempt to use it, and meshes and poses give it wherever an object is.
    """
    shot = stage.shot_of(camera, step)
    exact = replace(label(stage.scene, shot, passes, stock), alpha=None)
    if camera.moving:
        return replace(exact, depth=None)
    assert exact.depth is not None
    noise = np.random.default_rng((stage.scene.seed, shot, 1))
    return replace(exact, depth=sense_depth(exact.depth, exact.image, stage.config.depth, noise))
