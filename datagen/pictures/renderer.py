"""Our side of the Blender process: GPL code stays behind a pipe and is never imported here."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.processes import child_command, resident_memory
from datagen.scenes.spec import SceneSpec, scene_to_plain
from multicam.errors import MissingDependencyError, MulticamError

_APT = "apt-get install libxrender1 libxi6 libxkbcommon0 libxfixes3 libsm6 libgl1"


@dataclass(frozen=True, eq=False)
class Passes:
    """What the renderer saw.

    Attributes:
        color: (h, w, 3) float32 linear RGB.
        depth: (h, w) float32 metres along the optical axis, 0 where nothing was hit.
        index: (h, w) uint16, 1 + index of the labelled object, 0 for the rest.
        alpha: (h, w) float32, share of the pixel that labelled objects cover in `color`, 0..1.
    """

    color: NDArray[np.float32]
    depth: NDArray[np.float32]
    index: NDArray[np.uint16]
    alpha: NDArray[np.float32]


class RendererDied(MulticamError):
    """The Blender process ended by itself: it crashed, or was killed, or there was no memory left."""


class BlenderRenderer:
    """A Blender worker process as a context manager.

    Raises:
        MissingDependencyError: bpy or a system library that it needs is not installed.
    """

    def __init__(self, models: Path, samples: int, threads: int = 0) -> None:
        """`threads` of 0 takes all cores."""
        if importlib.util.find_spec("bpy") is None:
            raise MissingDependencyError("Rendering needs bpy: install it with pip install -e '.[datagen]'.")
        self._setup = {"models": str(models.resolve()), "samples": samples, "threads": threads}

    def __enter__(self) -> BlenderRenderer:
        self._log = tempfile.TemporaryFile()
        self._process = subprocess.Popen(
            child_command("datagen.blender.worker"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
        )
        try:
            self._ask(self._setup)
            self._read()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        # It has nothing to bring to an end: what it has rendered and nobody has read, nobody wants.
        self._process.kill()
        self._process.communicate()
        self._log.close()

    @property
    def memory(self) -> int:
        """Bytes of RAM that Blender holds."""
        return resident_memory(self._process.pid)

    def render(self, scene: SceneSpec, shots: Sequence[int]) -> Iterator[Passes]:
        """Renders the chosen shots of a scene, in order; Blender works ahead while the caller uses a picture.

        Raises:
            RendererDied: Blender ended.
        """
        self._ask({"scene": scene_to_plain(scene)})
        self._read()
        for position in range(len(shots) + 1):
            if position < len(shots):
                self._ask({"shot": shots[position], "seed": (scene.seed + shots[position]) % 2**31})
            if position > 0:
                yield Passes(*self._read())

    def settle(self, scene: SceneSpec) -> SceneSpec:
        """The scene after its loose objects fell and came to rest.

        Raises:
            RendererDied: Blender ended.
        """
        self._ask({"scene": scene_to_plain(scene)})
        self._read()
        self._ask({"settle": True})
        poses = self._read()[0]
        objects = tuple(replace(item, world_from_object=pose) for item, pose in zip(scene.objects, poses, strict=True))
        return replace(scene, objects=objects)

    def _ask(self, request: dict[str, Any]) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError as error:
            raise self._death() from error

    def _read(self) -> list[NDArray[Any]]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        # A line without its end is the last word of a process that was killed while it spoke.
        if not line.endswith(b"\n"):
            raise self._death()
        return [self._read_array(np.dtype(kind), shape) for kind, shape in json.loads(line)["arrays"]]

    def _read_array(self, dtype: np.dtype[Any], shape: list[int]) -> NDArray[Any]:
        assert self._process.stdout is not None
        array = np.empty(shape, dtype)
        size = self._process.stdout.readinto(array.reshape(-1).view(np.uint8))
        if size < array.nbytes:
            raise self._death()
        return array

    def _death(self) -> MulticamError:
        """What to say when the worker is gone: a missing system library is the user's, the rest is Blender's."""
        code = self._process.wait()
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").strip().splitlines()
        last = lines[-1].rstrip(".") if lines else "it said nothing"
        if "cannot open shared object file" in last:
            return MissingDependencyError(f"Blender lacks a system library ({last}); install them with: {_APT}.")
        return RendererDied(f"The Blender process ended with code {code}: {last}.")
