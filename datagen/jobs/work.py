"""One worker's side of the work, the same for every executor: scenes in, events out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from datagen.config import DatagenConfig
from datagen.pictures.generate import SceneMaker
from datagen.pictures.renderer import RendererDied
from multicam.errors import MulticamError

RECYCLE_SCENES = 200
"""Scenes after which a worker gives way to a fresh one, whatever its size."""
RECYCLE_GROWTH = 1.3
"""Memory, relative to that after its first scene, from which on it does."""


@dataclass(frozen=True)
class PictureDone:
    """A picture of the scene is on disk."""


@dataclass(frozen=True)
class SceneDone:
    """The scene is whole; `worn` asks for a fresh worker, for memory grows with the scenes."""

    worn: bool


@dataclass(frozen=True)
class WorkerDied:
    """The worker or its Blender ended in the midst of the scene; another may succeed."""

    words: str


@dataclass(frozen=True)
class SceneRefused:
    """The scene cannot be made, by nobody."""

    error: MulticamError


Event = PictureDone | SceneDone | WorkerDied | SceneRefused
"""What a worker says of its scene; all but the first are its last word about it."""


class SceneWorker:
    """Makes one scene after another, with one Blender."""

    def __init__(self, config: DatagenConfig, threads: int) -> None:
        self._config, self._threads = config, threads
        self._maker: SceneMaker | None = None
        self._scenes = 0
        self._first_memory = 0

    def perform(self, index: int) -> Iterator[Event]:
        """Makes what is missing of scene `index`."""
        try:
            if self._maker is None:
                self._maker = SceneMaker(self._config, self._threads)
            for _ in self._maker.make(index):
                yield PictureDone()
        except RendererDied as error:
            yield WorkerDied(str(error))
        except MulticamError as error:
            yield SceneRefused(error)
        else:
            yield SceneDone(self._worn(self._maker.memory))

    def close(self) -> None:
        """Ends Blender."""
        if self._maker is not None:
            self._maker.__exit__()

    def _worn(self, memory: int) -> bool:
        self._scenes += 1
        self._first_memory = self._first_memory or memory
        return self._scenes >= RECYCLE_SCENES or memory > RECYCLE_GROWTH * self._first_memory > 0
