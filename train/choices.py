"""What of a training depends on parts, pictures and machine, each chosen with its reason."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch

from models.config import Size
from models.dcc import ENLARGEMENT
from train.config import WINDOWS

_GRID = 32
_LEAST_SIDE = 32.0
"""Pixels of the input that nine in ten objects should measure: four cells of stride 8."""
_FOCAL, _DISTANCE = 1.15, 0.6
"""Focal length in widths of the image, and metres from the parts: the middle of what the generator draws by default."""
_UNCUT = 0.4
"""Share of a window's width that nine in ten parts may measure; about half of such parts are then cut."""
_BIN = 1.5
"""Pixels that a bin of the coordinate classifier may measure on nine in ten objects."""
_GPU_MEMORY = 24e9
_GPU_BATCH = 16
"""Pictures of 640 x 480 that the m network may take in a step with that memory."""
_LIGHTER: dict[Size, float] = {"nano": 4.0, "tiny": 3.0, "s": 2.0, "m": 1.0}
"""How many times more pictures than m a smaller network may take."""


class Choice(NamedTuple):
    """A piece of configuration, and why."""

    value: dict[str, Any]
    reason: str


@dataclass(frozen=True)
class Machine:
    """What a training may use.

    Attributes:
        cores: that this process may use.
        gpu_memory: bytes, or 0 without a GPU.
        bf16: whether the hardware has that arithmetic.
    """

    cores: int
    gpu_memory: int
    bf16: bool

    @classmethod
    def here(cls) -> Machine:
        """This machine."""
        cores = len(os.sched_getaffinity(0))
        if torch.cuda.is_available():
            return cls(cores, torch.cuda.get_device_properties(0).total_memory, torch.cuda.is_bf16_supported())
        able = torch.cpu.get_capabilities()
        return cls(cores, 0, bool(able.get("avx512_bf16") or able.get("amx_bf16")))


@dataclass(frozen=True)
class Pictures:
    """What the pictures hold; of the renders that are asked for where there are none yet.

    Attributes:
        count, validation: pictures to learn from, and to measure on.
        width, height: pixels.
        small, large: side (the longer one, pixels) that a tenth of the objects lie below, and above.
        rendered: whether the pictures are there.
        window: share of the sides of the camera's image that a picture to learn from shows.
    """

    count: int
    validation: int
    width: int
    height: int
    small: float
    large: float
    rendered: bool
    window: float = 1.0

    @property
    def together(self) -> int:
        """How many are put together to one picture in training."""
        return 1 if self.window == 1 else WINDOWS


def choose_size(classes: int, machine: Machine) -> tuple[Size, str]:
    """Depth and width of the network."""
    if machine.gpu_memory:
        memory = machine.gpu_memory / 1e9
        size: Size = "m" if memory > 16 else "s" if memory > 8 else "tiny"
        return size, f"{size}: a GPU with {memory:.0f} GB."
    size = "nano" if classes <= 12 else "tiny" if classes <= 30 else "s"
    return size, f"{size}: {classes} classes and no GPU; the next size takes about half as long again a picture."


def expected_pictures(count: int, validation: int, diameters: Sequence[float]) -> Pictures:
    """The renders to ask for: 320 x 240, windows at a quarter of the price of whole images where parts are small.

    Windows cut long parts, and what is cut off takes long to learn.

    Args:
        diameters: of the parts, metres.
    """
    small, large = (float(share) for share in np.quantile(diameters, (0.1, 0.9)) * _FOCAL / _DISTANCE)
    window = 0.5 if large < 0.5 * _UNCUT else 1.0
    return Pictures(count, validation, 320, 240, 320 * small / window, 320 * large / window, False, window)


def choose_input(pictures: Pictures, machine: Machine) -> tuple[int, int, str]:
    """Width and height of a picture in training, with the pictures' shape."""
    least, most = (640, 1280) if machine.gpu_memory else (320, 640)
    wanted = pictures.width * _LEAST_SIDE / pictures.small
    # More pixels than the pictures have show nothing new.
    width = _to_grid(min(max(wanted, least), most, pictures.width))
    height = _to_grid(width * pictures.height / pictures.width)
    smallest = pictures.small * width / pictures.width
    reason = f"{width} x {height} in training: nine in ten objects then measure {smallest:.0f} pixels or more."
    if smallest < _LEAST_SIDE / 2:
        reason += " That is little: bring the cameras nearer, or take larger pictures."
    return width, height, reason


def input_sizes(pictures: Pictures, width: int, height: int) -> dict[str, int]:
    """The network's input, for pictures of some size in training; larger than those where they are windows."""
    if pictures.window == 1:
        return {"input_width": width, "input_height": height}
    whole = _to_grid(width / pictures.window)
    tall = _to_grid(whole * pictures.height / pictures.width)
    return {"input_width": whole, "input_height": tall, "window_width": width, "window_height": height}


def choose_bins(pictures: Pictures, width: int) -> tuple[int, str]:
    """Bins per axis of the coordinate classifier."""
    side = pictures.large * width / pictures.width * ENLARGEMENT
    bins = 128 if side / 128 <= _BIN else 256
    return bins, f"{bins} bins: {side / bins:.1f} pixels each on large objects."


def choose_batch(size: Size, area: int, pictures: Pictures, machine: Machine) -> tuple[int, str]:
    """Pictures of a step, of so many pixels each."""
    most = max(pictures.count // pictures.together, 1)
    made = "" if pictures.together == 1 else f", each put together of {pictures.together} windows"
    if not machine.gpu_memory:
        batch = min(8 // pictures.together, most)
        return batch, f"{batch} pictures a step{made}: a larger batch is no faster on a CPU and makes fewer steps."
    fits = _GPU_BATCH * machine.gpu_memory / _GPU_MEMORY * (640 * 480) / area * _LIGHTER[size]
    batch = min(max(4 * int(fits / 4), 4), 64, most)
    return batch, f"{batch} pictures a step{made} should fit {machine.gpu_memory / 1e9:.0f} GB; --dry-run measures it."


def choose_stages(
    recipe: dict[str, Any], classes: int, pictures: int, batch: int, machine: Machine
) -> tuple[dict[str, Any], str]:
    """The stages of a recipe, as long as so many classes need, with learning rates for the batch."""
    seen = (600_000 + 200_000 * classes) if machine.gpu_memory else (60_000 + 20_000 * classes)
    epochs = min(max(round(seen / pictures), 10), 400)
    stages: dict[str, Any] = recipe["stages"]
    whole = sum(stage["epochs"] for stage in stages.values())
    scale = batch / recipe.get("batch_size", 8)
    chosen = {
        name: {
            **stage,
            "epochs": max(round(stage["epochs"] * epochs / whole), 1),
            "learning_rate_start": stage["learning_rate_start"] * scale,
            "learning_rate_end": stage["learning_rate_end"] * scale,
        }
        for name, stage in stages.items()
    }
    reason = (
        f"About {epochs * pictures:,} pictures are seen, for {classes} classes; --dry-run says how long that takes. "
        "Learning rates go with the batch."
    )
    if epochs == 400:
        reason += f" {pictures} pictures are few: render more before you train longer."
    return chosen, reason


def choose_workers(machine: Machine) -> tuple[int, str]:
    """Processes that load pictures."""
    if not machine.gpu_memory and machine.cores <= 2:
        return (
            0,
            f"{machine.cores} cores: the training process loads pictures itself, for the network wants all of them.",
        )
    workers = min(machine.cores - 1, 12) if machine.gpu_memory else 1
    return workers, f"{workers} of {machine.cores} cores load pictures; --dry-run says whether the network waits."


def _to_grid(pixels: float) -> int:
    return max(_GRID * math.ceil(pixels / _GRID - 1e-9), 2 * _GRID)
