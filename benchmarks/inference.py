"""Time of network files side by side: the same pictures through each in turn, so that other work meets all alike.

    python benchmarks/inference.py network.onnx network-int8.onnx --batches 1 3 --threads 2

Give the fp32 file first: the others are stated as shares of it. With one thread, the processor's time is what the clock
would show on a machine with nothing else to do.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from multicam.inference.session import Network, SessionConfig


@dataclass(frozen=True)
class Config:
    files: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Network files of one input size."""
    batches: tuple[int, ...] = (1, 3)
    """Pictures that go through the network together."""
    provider: str = "cpu"
    """Execution provider."""
    threads: int = 0
    """CPU threads of one operator; 0 takes all cores."""
    rounds: int = 30
    """Runs of each file and batch; the fastest counts."""


def main(config: Config) -> None:
    networks = [Network(path, SessionConfig(config.provider, config.threads)) for path in config.files]
    rng = np.random.default_rng(0)
    for batch in config.batches:
        inputs = [rng.integers(0, 256, (batch, n.metadata.height, n.metadata.width, 3), np.uint8) for n in networks]
        times: list[list[tuple[float, float]]] = [[] for _ in networks]
        for _ in range(2 + config.rounds):
            for network, pictures, found in zip(networks, inputs, times, strict=True):
                began = time.perf_counter(), time.process_time()
                network.run(pictures)
                found.append((time.perf_counter() - began[0], time.process_time() - began[1]))
        best = np.array([np.min(found[2:], axis=0) for found in times])
        for path, network, (wall, processor), share in zip(config.files, networks, best, best / best[0], strict=True):
            print(
                f"{path.name:24} {network.metadata.precision}  batch {batch}  {1000 * wall:7.1f} ms  "
                f"processor {1000 * processor:7.1f} ms, {share[1]:.2f} of the first"
            )


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
