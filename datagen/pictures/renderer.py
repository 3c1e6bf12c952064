"""Our side of the Blender process: GPL code stays behind a pipe and is never imported here."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    """

    color: NDArray[np.float32]
    depth: NDArray[np.float32]
    index: NDArray[np.uint16]


class BlenderRenderer:
    """A Blender worker process as a context manager.

    Raises:
        MissingDependencyError: bpy or a system library that it needs is not installed.
    """

    def __init__(self, models: Path, samples: int) -> None:
        if importlib.util.find_spec("bpy") is None:
            raise MissingDependencyError("Rendering needs bpy: install it with pip install -e '.[datagen]'.")
        self._models, self._samples = models, samples

    def __enter__(self) -> BlenderRenderer:
        self._log = tempfile.TemporaryFile()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "datagen.blender.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            cwd=Path(__file__).parents[2],
            text=True,
        )
        self._ask({"models": str(self._models.resolve()), "samples": self._samples})
        self._read()
        return self

    def __exit__(self, *_: object) -> None:
        # The end of its input ends the worker, after the picture it is at.
        self._process.communicate()
        self._log.close()

    def render(self, scene: SceneSpec, shots: Sequence[int]) -> Iterator[Passes]:
        """Renders the chosen shots of a scene, in order; Blender works ahead while the caller uses a picture."""
        self._ask({"scene": scene_to_plain(scene)})
        self._read()
        for position in range(len(shots) + 1):
            if position < len(shots):
                self._ask({"shot": shots[position], "seed": (scene.seed + shots[position]) % 2**31})
            if position > 0:
                yield _take(Path(self._read()["file"]))

    def _ask(self, request: dict[str, Any]) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError as error:
            raise self._death() from error

    def _read(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise self._death()
        return json.loads(line)

    def _death(self) -> MulticamError:
        """What to say when the worker is gone: a missing system library is the user's, the rest is Blender's."""
        code = self._process.wait()
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").strip().splitlines()
        last = lines[-1] if lines else "it said nothing"
        if "cannot open shared object file" in last:
            return MissingDependencyError(f"Blender lacks a system library ({last}); install them with: {_APT}.")
        return MulticamError(f"The Blender process ended with code {code}: {last}.")


def _take(path: Path) -> Passes:
    with np.load(path) as arrays:
        passes = Passes(arrays["color"], arrays["depth"], arrays["index"])
    path.unlink()
    return passes
