"""A whole data set: what is missing, who makes it, how far it has come, and a last word when it is stopped."""

from __future__ import annotations

import logging
import signal
import threading
import time
from collections.abc import Generator
from contextlib import closing, contextmanager
from types import FrameType

from datagen.config import DatagenConfig
from datagen.jobs.local import LocalExecutor
from datagen.jobs.pool import Executor, run_scenes
from datagen.pictures.generate import is_finished, missing_images
from datagen.pictures.manifest import FREE
from datagen.pictures.output import claim, copy_models
from multicam.dataset.objects import load_catalogue
from multicam.progress import Progress, SilentProgress

_log = logging.getLogger(__name__)


def generate(config: DatagenConfig, progress: Progress | None = None) -> None:
    """Renders the data set of a configuration, or what is missing of it.

    Pictures depend on the configuration alone: not on when the run was stopped or continued, not on who made them.

    Raises:
        DataError: the models do not fit, the folder holds another configuration's pictures, or labels disagree
            with the render.
        MissingDependencyError: Blender cannot start, or Ray is asked for and not installed.
        MulticamError: worker after worker died at the same scene.
        KeyboardInterrupt: Ctrl-C or SIGTERM; what was finished is kept.
    """
    load_catalogue(config.models)
    split = config.output / config.split
    # More pictures of the same kind may be asked for, folders may move, and others may go on with the work.
    claim(split / "config.yaml", config, FREE)
    copy_models(config.models, config.output / "models")
    plan = {i: len(missing_images(config, i)) for i in range(config.scenes) if not is_finished(config, i)}
    total = sum(plan.values())
    _log.info("%d of %d pictures are to be rendered into %s", total, config.images, split)
    if not plan:
        return
    began, done = time.monotonic(), 0
    executor = _executor(config)
    try:
        # Closing ends the workers wherever the interruption struck.
        with _sigterm_as_interrupt(), closing(run_scenes(executor, plan, config.seed)) as pictures:
            for _ in (progress or SilentProgress()).track(pictures, f"rendering {config.split}", total):
                done += 1
    except KeyboardInterrupt:
        there = config.images - total + done
        _log.info("stopped with %d of %d pictures done; the same command goes on", there, config.images)
        raise
    hours = (time.monotonic() - began) / 3600
    _log.info("rendered %d pictures, %.0f an hour", total, total / hours)


def _executor(config: DatagenConfig) -> Executor:
    if config.executor == "local":
        return LocalExecutor(config)
    from datagen.jobs.ray_cluster import RayExecutor

    return RayExecutor(config)


@contextmanager
def _sigterm_as_interrupt() -> Generator[None]:
    """SIGTERM, as `kill` and batch systems send it, ends the work like Ctrl-C."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        # Only the main thread may set handlers; whoever runs this in another one has its own way to stop.
        yield
        return
    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
