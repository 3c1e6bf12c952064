"""Images per hour beside BlenderProc: same scenes, same meshes, same samples, scene by scene in turns.

    python benchmarks/datagen_speed.py --blenderproc /path/to/python --models data/instruments/models

Ours: sampled, rendered, labelled, checked and written. BlenderProc: rendered with its defaults (but our number of
samples), depth and instance segmentation, loaded, and written with its BOP writer, without masks. Its interpreter has
bpy 4.5, what multicam-pose needs, and a BlenderProc that takes an external bpy (its development version, which may be
on PYTHONPATH). The rows between show BlenderProc with one of our differences after the other.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from datagen.config import DatagenConfig, RandomizationConfig
from datagen.pictures.generate import label
from datagen.pictures.renderer import BlenderRenderer
from datagen.scenes.sample import sample_scene
from datagen.scenes.spec import SceneSpec, scene_to_plain
from datagen.scenes.stock import Stock, load_stock
from multicam.config import parse_command
from multicam.dataset.bop_writer import SceneWriter

ROWS = ("BlenderProc", "+ small importance map", "+ fixed samples", "+ denoiser in Cycles")
SIZES = ((320, 240), (640, 480))


@dataclass(frozen=True)
class SpeedConfig:
    """Options of the benchmark."""

    blenderproc: Path
    """Python interpreter that has BlenderProc."""
    models: Path = Path("data/instruments/models")
    """BOP models folder."""
    output: Path = Path(tempfile.gettempdir(), "datagen-speed")
    """Scratch folder, emptied first."""
    scenes: int = 4
    """Scenes of each size; one more is rendered first and not counted."""
    images: int = 6
    """Pictures of a scene."""
    samples: int = 4
    """Paths per pixel, on both sides."""
    between: bool = True
    """Also BlenderProc with our differences, one after the other."""


def main() -> None:
    config = parse_command(SpeedConfig, sys.argv[1:], "datagen_speed.py", __doc__ or "")
    shutil.rmtree(config.output, ignore_errors=True)
    stock = load_stock(config.models)
    table = Table("", *(f"{w}x{h}: images/h" for w, h in SIZES), *("ours is faster by" for _ in SIZES))
    seconds = [measure(config, stock, *size) for size in SIZES]
    for row in seconds[0]:
        rates = [3600 * config.images / np.median(size[row]) for size in seconds]
        ratios = [np.median(np.divide(size[row], size["ours"])) for size in seconds]
        table.add_row(row, *(f"{rate:.0f}" for rate in rates), *(f"{ratio:.2f}" for ratio in ratios))
    Console().print(table)


def measure(config: SpeedConfig, stock: Stock, width: int, height: int) -> dict[str, list[float]]:
    """Seconds of each scene, by row; the first scene, in which both sides load their kernels, is left out."""
    # Lens, motion and overlays have no counterpart there.
    job = DatagenConfig(
        models=config.models, images=config.images * (config.scenes + 1), images_per_scene=config.images, width=width,
        height=height, samples=config.samples, randomize=RandomizationConfig(lens=False, motion=False, overlays=False),
    )  # fmt: skip
    folder = config.output / f"{width}x{height}"
    rows = ROWS if config.between else ROWS[:1]
    seconds: dict[str, list[float]] = defaultdict(list)
    with BlenderRenderer(job.models, job.samples) as ours, ExitStack() as stack:
        theirs = [stack.enter_context(BlenderProc(config, differences)) for differences in range(len(rows))]
        for index in range(config.scenes + 1):
            scene = with_one_lens(sample_scene(job, stock, index))
            for row, process in zip(rows, theirs, strict=True):
                began = time.perf_counter()
                process.render(scene, folder / row / f"{index}")
                seconds[row].append(time.perf_counter() - began)
            began = time.perf_counter()
            writer = SceneWriter(folder / "ours" / f"{index:06d}")
            # Sampling is part of our work, though its result is used on both sides.
            sample_scene(job, stock, index)
            for im_id, passes in enumerate(ours.render(scene, range(config.images))):
                writer.add(im_id, label(scene, im_id, passes, stock))
            seconds["ours"].append(time.perf_counter() - began)
            print(width, index, {row: round(values[-1], 2) for row, values in seconds.items()}, flush=True)
    return {row: values[1:] for row, values in seconds.items()}


def with_one_lens(scene: SceneSpec) -> SceneSpec:
    """BlenderProc has one camera matrix for all pictures of a call."""
    return replace(scene, shots=tuple(replace(shot, camera=scene.shots[0].camera) for shot in scene.shots))


class BlenderProc:
    """A process of it, with so many of our differences, as a context manager."""

    def __init__(self, config: SpeedConfig, differences: int) -> None:
        script = Path(__file__).with_name("blenderproc_side.py")
        paths = os.pathsep.join(filter(None, (os.environ.get("PYTHONPATH"), str(script.parents[1]))))
        self._process = subprocess.Popen(
            [config.blenderproc, script, config.models, str(config.samples), str(differences)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=os.environ | {"PYTHONPATH": paths}, text=True,
        )  # fmt: skip

    def __enter__(self) -> BlenderProc:
        self._answer()
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()

    def render(self, scene: SceneSpec, output: Path) -> None:
        assert self._process.stdin is not None
        request = {"scene": scene_to_plain(scene), "output": str(output)}
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        answer = self._answer()
        assert answer == {"output": str(output)}, answer

    def _answer(self) -> dict[str, str]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, "BlenderProc ended; what it said is above"
        return json.loads(line)


if __name__ == "__main__":
    main()
