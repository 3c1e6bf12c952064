"""`multicam train new`: a good configuration for somebody's own parts, with the reasons beside the numbers.

The recipe (losses, augmentation, shape of the schedule) is that of a configuration in `configs/train`; what depends on
parts, pictures and machine is chosen here.
"""

from __future__ import annotations

import logging
import shlex
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from models.config import Size
from multicam.config import from_mapping, parse_command, read_yaml
from multicam.dataset.bop_reader import ImageRecord, read_image
from multicam.dataset.objects import Catalogue, load_catalogue
from multicam.errors import DataError
from multicam.files import write_text
from multicam.geometry import se3
from train.choices import (
    Choice,
    Machine,
    Pictures,
    choose_batch,
    choose_bins,
    choose_input,
    choose_size,
    choose_stages,
    choose_workers,
    expected_pictures,
    input_sizes,
)
from train.config import TrainConfig
from train.exported import exported_size
from train.folded import NetworkFile
from train.published import published_size
from train.samples import project, read_records

log = logging.getLogger(__name__)

_RECIPES = Path(__file__).parents[1] / "configs" / "train"
_CPU, _GPU = _RECIPES / "instruments.yaml", _RECIPES / "lmo.yaml"
_CACHED = 4e9
"""Bytes of decoded pictures that are kept in memory."""
_PIXEL = 7
"""Bytes of a pixel with its depth."""


@dataclass(frozen=True)
class NewConfig:
    """Options of `multicam train new`."""

    models: Path
    """BOP models folder with keypoints.json."""
    data: Path | None = None
    """Data set folder with the splits train and val; DATA of MODELS = DATA/models if left out. It may be empty yet."""
    initial: Path | None = None
    """Network file to begin with, whose size is taken: one that `multicam export` wrote, or a published YOLOX,
    yolox_nano.onnx and so on (docs/training.md says where from). What it has seen need not be learnt again, which takes
    a CPU hours."""
    output: Path = Path("train.yaml")
    """Configuration to write; never overwritten."""


def main(argv: list[str]) -> None:
    """Writes the configuration and says what to do next.

    Raises:
        DataError: models without keypoints, or a file that is there already.
    """
    description = "Writes a training configuration for parts of your own: network, input and schedule chosen for them."
    config = parse_command(NewConfig, argv, "multicam train new", description)
    if config.output.exists():
        raise DataError(f"{config.output} exists; choose another --output, or remove it.")
    catalogue = read_parts(config.models)
    data = config.data or config.models.absolute().parent
    pictures = look_at(data, catalogue)
    write_text(config.output, compose(config, data, catalogue, pictures, Machine.here()))
    log.info("wrote %s; next:\n%s", config.output, "\n".join(next_commands(config, data, catalogue, pictures)))


def read_parts(models: Path) -> Catalogue:
    """The models, if they are ready to be learnt.

    Raises:
        DataError: keypoints or meshes are missing; the sentence says how to make them.
    """
    catalogue = load_catalogue(models)
    parts = catalogue.objects.values()
    without = [part.name for part in parts if part.keypoints is None]
    if without:
        raise DataError(
            f"{models} has no keypoints for {', '.join(without)}; "
            f"`multicam datagen keypoints --models {shlex.quote(str(models))}` adds them."
        )
    meshless = [part.name for part in parts if part.mesh_path is None]
    if meshless:
        raise DataError(f"{models} has no mesh for {', '.join(meshless)} (obj_000001.ply and so on); add them.")
    counts = {part.name: len(part.keypoints) for part in parts if part.keypoints is not None}
    if len(set(counts.values())) > 1:
        raise DataError(
            f"the parts of {models} have different numbers of keypoints ({counts}); "
            "`multicam datagen keypoints --replace` gives all of them the same."
        )
    return catalogue


def look_at(data: Path, catalogue: Catalogue) -> Pictures:
    """Counts and sizes of the pictures, or those of the renders that `next_commands` asks for."""
    train, validation = (read_records((data / n,)) if (data / n).is_dir() else [] for n in ("train", "val"))
    if not train:
        diameters = [part.diameter for part in catalogue.objects.values()]
        return expected_pictures(recommended_pictures(catalogue), len(validation), diameters)
    assert train[0].rgb_path is not None
    height, width = read_image(train[0].rgb_path).shape[:2]
    sides = np.array([side for record in train for side in _sides(record, catalogue)])
    small, large = np.quantile(sides, (0.1, 0.9))
    made_by = data / "train" / "config.yaml"
    camera = read_yaml(made_by).get("camera", {}) if made_by.is_file() else {}
    window = float(camera.get("window", 1.0))
    return Pictures(len(train), len(validation), width, height, float(small), float(large), True, window)


def recommended_pictures(catalogue: Catalogue) -> int:
    """Training pictures to render for some classes."""
    return 2000 + 250 * len(catalogue.objects)


def next_commands(config: NewConfig, data: Path, catalogue: Catalogue, pictures: Pictures) -> list[str]:
    """Command lines from here to a network."""
    models, folder, file = (shlex.quote(str(path)) for path in (config.models, data, config.output))
    render = f"  multicam datagen render --models {models} --output {folder}"
    window = "" if pictures.window == 1 else f" --camera.window {pictures.window:g}"
    commands: list[str] = []
    if not pictures.rendered:
        commands.append(f"{render} --images {recommended_pictures(catalogue)} --images-per-scene 6{window}")
    if not pictures.validation:
        size = f"--width {round(pictures.width / pictures.window)} --height {round(pictures.height / pictures.window)}"
        commands.append(f"{render} --split val --seed 1 --images 200 --images-per-scene 4 {size}")
    return [*commands, *(f"  multicam train --config {file}{option}" for option in (" --sanity", " --dry-run", ""))]


def compose(config: NewConfig, data: Path, catalogue: Catalogue, pictures: Pictures, machine: Machine) -> str:
    """The configuration as YAML, every choice with its reason above it.

    Raises:
        ConfigError: the recipe does not fit this version.
        DataError: what to begin with is no published YOLOX.
    """
    path = _GPU if machine.gpu_memory else _CPU
    recipe = read_yaml(path)
    size, depthwise, why_size = _network(config, len(catalogue.objects), machine)
    width, height, why_input = choose_input(pictures, machine)
    bins, why_bins = choose_bins(pictures, width)
    inputs = input_sizes(pictures, width, height)
    batch, why_batch = choose_batch(size, inputs["input_width"] * inputs["input_height"], pictures, machine)
    each_step = batch * pictures.together
    stages, why_stages = choose_stages(recipe, len(catalogue.objects), pictures.count, each_step, machine)
    workers, why_workers = choose_workers(machine)
    epochs = sum(stage["epochs"] for stage in stages.values())
    shape = {key: recipe["network"][key] for key in ("neck", "strides") if key in recipe["network"]}
    network = {"size": size, "depthwise": depthwise, **shape, "bins": bins, **inputs}
    folders = {"train": [str(data / "train")], "validation": [str(data / "val")], "models": str(config.models)}
    cache = pictures.count * pictures.width * pictures.height * _PIXEL < _CACHED
    source = "measured" if pictures.rendered else "expected; nothing is rendered yet"
    kept = {key: recipe[key] for key in ("augment", "optimizer", "ema_decay", "least_positives") if key in recipe}
    steps = max(pictures.count // each_step, 1) * epochs
    begin = [Choice({"initial": str(config.initial)}, "What backbone and neck begin with.")] if config.initial else []
    sections = (
        Choice({"output": f"runs/{data.absolute().name}"}, "Checkpoints and TensorBoard."),
        Choice(
            {"data": {**folders, "cache": cache, "validation_limit": 200}},
            f"{pictures.count} pictures of {pictures.width} x {pictures.height} ({source}), kept in memory where they "
            f"take less than {_CACHED / 1e9:.0f} GB.",
        ),
        Choice({"network": network}, f"{why_size} {why_input} {why_bins}"),
        *begin,
        Choice({"stages": stages}, why_stages),
        Choice(kept, f"As in configs/train/{path.name}."),
        Choice({"batch_size": batch}, why_batch),
        Choice({"warmup_steps": min(recipe["warmup_steps"], max(steps // 20, 1))}, "At most a twentieth of the run."),
        Choice({"validate_every": max(epochs // 15, 1)}, "About 15 validations."),
        Choice({"workers": workers}, why_workers),
        Choice(
            {"precision": "bf16" if machine.bf16 else "fp32"},
            f"This machine {'computes' if machine.bf16 else 'cannot compute'} in bf16.",
        ),
    )
    merged = {key: value for choice in sections for key, value in choice.value.items()}
    from_mapping(TrainConfig, merged, "the new configuration")
    parts = ", ".join(part.name for part in catalogue.objects.values())
    head = f"{len(catalogue.objects)} parts: {parts}. Written by `multicam train new`; change what you know better."
    return _comment(head) + "".join(f"\n{_comment(choice.reason)}{_dump(choice.value)}" for choice in sections)


def _network(config: NewConfig, classes: int, machine: Machine) -> tuple[Size, bool, str]:
    """Size, whether convolutions are depthwise, and why."""
    if config.initial:
        file = NetworkFile.read(config.initial)
        size, depthwise = exported_size(file) if file.metadata else published_size(file)
        return size, depthwise, f"{size}: that of {config.initial.name}."
    size, why = choose_size(classes, machine)
    return size, False, why


def _sides(record: ImageRecord, catalogue: Catalogue) -> list[float]:
    """Longer side in pixels of each object of a picture."""
    assert record.camera_matrix is not None
    boxes = [
        project(record.camera_matrix, se3.act(instance.camera_from_object, catalogue[instance.obj_id].box_corners()))
        for instance in record.instances
    ]
    return [float(np.ptp(box, axis=0).max()) for box in boxes]


def _comment(text: str) -> str:
    return "".join(f"# {line}\n" for line in textwrap.wrap(text, 110))


def _dump(values: dict[str, Any]) -> str:
    text = ""
    for key, value in values.items():
        body = yaml.safe_dump(value, sort_keys=False, default_flow_style=None, width=110).removesuffix("...\n")
        nested = isinstance(value, dict) and not body.startswith("{")
        text += f"{key}:\n{textwrap.indent(body, '  ')}" if nested else f"{key}: {body}"
    return text
