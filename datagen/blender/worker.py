"""The Blender process: reads one JSON request a line from stdin, answers one JSON line each on stdout.

First {"models": folder, "samples": n}, then any number of {"scene": SceneSpec as plain data} and {"shot": index,
"seed": n}. A shot is answered by {"file": path} of an .npz with color, depth and index, which the asker removes;
everything else by {}. The process ends with its input, also when the asker was killed, and leaves no files.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from datagen.blender.build import Builder
from datagen.blender.render import Renderer
from datagen.scenes.spec import scene_from_plain
from multicam.dataset.objects import load_catalogue


def serve() -> None:
    """Answers requests until stdin ends."""
    # Blender writes chatter to file descriptor 1; the answers get a descriptor of their own.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    setup: dict[str, Any] = json.loads(sys.stdin.readline())
    catalogue = load_catalogue(Path(setup["models"]))
    builder = Builder({obj_id: catalogue[obj_id].load_mesh() for obj_id in catalogue.obj_ids})
    with tempfile.TemporaryDirectory(prefix="datagen-") as folder:
        renderer = Renderer(setup["samples"], Path(folder))
        _answer(answers, {})
        scene = None
        # Not `for line in stdin`, which reads ahead.
        while line := sys.stdin.readline():
            request: dict[str, Any] = json.loads(line)
            if "scene" in request:
                scene = scene_from_plain(request["scene"])
                builder.build(scene)
                _answer(answers, {})
                continue
            assert scene is not None, "a shot needs a scene"
            builder.arrange(scene, request["shot"])
            path = Path(folder) / f"{request['shot']:06d}.npz"
            color, depth, index = renderer.render(scene.shots[request["shot"]], request["seed"])
            np.savez(path, color=color, depth=depth, index=index)
            _answer(answers, {"file": str(path)})


def _answer(stream: Any, answer: dict[str, Any]) -> None:
    stream.write(json.dumps(answer) + "\n")
    stream.flush()


if __name__ == "__main__":
    serve()
