"""The Blender process: reads one JSON request a line from stdin and answers on stdout.

First {"models": folder, "samples": n, "threads": n, 0 for all cores}, then any number of {"scene": SceneSpec as plain
data}, {"settle": true} and {"shot": index, "seed": n}. Every answer is one line of JSON, {"arrays": [[dtype, shape],
...]}, and then the bytes of these arrays: for a shot its `Pixels`, for settling the poses of the objects, otherwise
none. The process ends with its input or its parent, and never has a file on disk that it could leave behind.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import bpy
from numpy.typing import NDArray

from datagen.blender.build import Builder
from datagen.blender.render import Renderer
from datagen.scenes.spec import scene_from_plain
from multicam.dataset.objects import load_catalogue


def serve() -> None:
    """Answers requests until stdin ends."""
    # Blender writes chatter to file descriptor 1; the answers get a descriptor of their own.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    setup: dict[str, Any] = json.loads(sys.stdin.readline())
    catalogue = load_catalogue(Path(setup["models"]))
    builder = Builder({obj_id: catalogue[obj_id].load_mesh() for obj_id in catalogue.obj_ids})
    renderer = Renderer(setup["samples"], setup["threads"])
    # Blender removes its own folder when it ends, but not when it is killed, and we need none.
    os.rmdir(bpy.app.tempdir)
    _answer(answers)
    scene = None
    # Not `for line in stdin`, which reads ahead.
    while line := sys.stdin.readline():
        request: dict[str, Any] = json.loads(line)
        if "scene" in request:
            scene = scene_from_plain(request["scene"])
            builder.build(scene)
            _answer(answers)
            continue
        assert scene is not None, "everything else needs a scene"
        if "settle" in request:
            _answer(answers, (builder.settle(scene),))
            continue
        builder.arrange(scene, request["shot"])
        _answer(answers, renderer.render(scene.shots[request["shot"]], request["seed"]))


def _answer(stream: BinaryIO, arrays: Sequence[NDArray[Any]] = ()) -> None:
    header = {"arrays": [[array.dtype.str, array.shape] for array in arrays]}
    stream.write(json.dumps(header).encode() + b"\n")
    for array in arrays:
        stream.write(array.tobytes())
    stream.flush()


if __name__ == "__main__":
    serve()
