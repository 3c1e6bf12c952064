"""Memory of one Blender process, scene after scene, never recycled.

    python benchmarks/datagen_memory.py --scenes 300 --models data/instruments/models

The first scenes fill caches (kernels, environment maps, meshes), so growth is counted from scene WARM on.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datagen.config import DatagenConfig
from datagen.pictures.renderer import BlenderRenderer
from datagen.scenes.sample import sample_scene
from datagen.scenes.stock import load_stock
from multicam.config import parse_command

WARM = 20


@dataclass(frozen=True)
class MemoryConfig:
    """Options of the benchmark."""

    scenes: int = 300
    """How many."""
    models: Path = Path("data/instruments/models")
    """BOP models folder."""


def main() -> None:
    config = parse_command(MemoryConfig, sys.argv[1:], "datagen_memory.py", __doc__ or "")
    job = DatagenConfig(
        models=config.models, images=2 * config.scenes, images_per_scene=2, width=64, height=48, samples=1
    )
    stock = load_stock(job.models)
    sizes: list[float] = []
    began = time.monotonic()
    with BlenderRenderer(job.models, job.samples) as blender:
        for index in range(config.scenes):
            for _ in blender.render(sample_scene(job, stock, index), [0, 1]):
                pass
            sizes.append(blender.memory / 2**20)
            if index % 10 == 0:
                print(f"scene {index:4}: {sizes[-1]:7.1f} MB, {time.monotonic() - began:5.0f} s", flush=True)
    settled = np.array(sizes[WARM:])
    slope = np.polyfit(np.arange(len(settled)), settled, 1)[0]
    first, last = settled[:10].mean(), settled[-10:].mean()
    print(f"scenes {WARM} to {config.scenes}: {first:.1f} to {last:.1f} MB, {100 * (last / first - 1):+.1f} %")
    print(f"slope {1024 * slope:.0f} KB a scene, which is {100 * 300 * slope / first:+.1f} % in 300 scenes")


if __name__ == "__main__":
    main()
