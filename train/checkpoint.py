"""Checkpoints: folders of safetensors and JSON that appear whole or not at all, and resume bit by bit.

A checkpoint holds model.safetensors (raw weights), ema.safetensors (their moving average, the ones to use),
training.safetensors (optimizer moments, random states), model.json, objects.json, views.json (canonical views of the
objects with symmetries) and state.json. Nothing is pickled.
"""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from models.config import ModelConfig
from multicam.config import from_mapping, to_mapping
from multicam.dataset.objects import Catalogue, ObjectModel
from multicam.errors import DataError, ModelError
from multicam.files import read_json, require_file, write_json
from multicam.inference.metadata import objects_from_json, objects_to_json
from multicam.types import FloatArray
from train.optimizer import MovingAverage

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RunState:
    """Where a run stands, and what is worth knowing of its weights.

    Attributes:
        epoch, step: the next step to do; step counts within the epoch.
        input_width, input_height: pixels the network was trained on.
        ema_updates: of the moving average.
        best: validation figures of the best checkpoint so far.
        metrics: validation figures of these weights, or of the last ones validated.
    """

    epoch: int
    step: int
    input_width: int
    input_height: int
    ema_updates: int = 0
    best: dict[str, float] = field(default_factory=dict[str, float])
    metrics: dict[str, float] = field(default_factory=dict[str, float])


def save_checkpoint(
    folder: Path,
    model: nn.Module,
    average: MovingAverage,
    optimizer: torch.optim.Optimizer,
    config: ModelConfig,
    catalogue: Catalogue,
    views: Mapping[int, FloatArray],
    state: RunState,
) -> None:
    """Writes a checkpoint folder beside `folder`, then puts it in its place."""
    new, old = folder.with_name(f".{folder.name}-new"), folder.with_name(f".{folder.name}-old")
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    save_file(_contiguous(model.state_dict()), new / "model.safetensors")
    save_file(_contiguous(average.model.state_dict()), new / "ema.safetensors")
    save_file(_training_tensors(model, optimizer), new / "training.safetensors")
    write_json(new / "model.json", to_mapping(config), indent=1)
    write_json(new / "objects.json", objects_to_json(catalogue), indent=1)
    write_json(new / "views.json", {str(obj_id): view.tolist() for obj_id, view in views.items()}, indent=1)
    write_json(new / "state.json", asdict(state), indent=1)
    for path in new.iterdir():
        with open(path, "rb") as stream:
            os.fsync(stream.fileno())
    # Folders cannot be exchanged in one step; `find_checkpoint` mends a stop between these two.
    shutil.rmtree(old, ignore_errors=True)
    if folder.exists():
        folder.rename(old)
    new.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def find_checkpoint(folder: Path) -> Path | None:
    """Returns the folder if it is there, putting back one that was being replaced when the program was killed."""
    old = folder.with_name(f".{folder.name}-old")
    if not folder.exists() and old.is_dir():
        old.rename(folder)
    return folder if folder.is_dir() else None


def load_weights(folder: Path) -> tuple[ModelConfig, Catalogue, dict[str, Tensor]]:
    """Network, classes and averaged weights of a checkpoint.

    Raises:
        DataError, ModelError: the folder is no checkpoint, or damaged.
    """
    find_checkpoint(folder)
    return load_model_config(folder), _load_objects(folder), _read_tensors(folder / "ema.safetensors")


def load_model_config(folder: Path) -> ModelConfig:
    """The network of a checkpoint."""
    path = folder / "model.json"
    return from_mapping(ModelConfig, read_json(path), str(path))


def load_views(folder: Path, catalogue: Catalogue) -> dict[int, FloatArray]:
    """Canonical views (3, 3), by obj_id, of those objects of a catalogue that the network of a checkpoint has learnt.

    An object is known by its keypoints, not by its number: the other training may have counted otherwise.

    Raises:
        DataError, ModelError: the folder is no checkpoint, or damaged.
    """
    find_checkpoint(folder)
    theirs = _load_objects(folder)
    path = folder / "views.json"
    if not path.is_file():
        log.warning(
            "%s has no views.json; labels of objects with symmetries may differ from what it has learnt", folder
        )
        return {}
    try:
        views = {
            int(obj_id): np.array(rows, dtype=np.float64).reshape(3, 3) for obj_id, rows in read_json(path).items()
        }
        learnt = [(theirs[obj_id], view) for obj_id, view in views.items()]
    except (AttributeError, TypeError, ValueError) as error:
        raise DataError(f"{path} does not hold views as this program writes them: {error}.") from error
    return {
        obj_id: view
        for obj_id, model in catalogue.objects.items()
        for other, view in learnt
        if model.symmetries and _same_keypoints(model, other)
    }


def _same_keypoints(model: ObjectModel, other: ObjectModel) -> bool:
    ours, theirs = model.keypoints, other.keypoints
    return ours is not None and theirs is not None and ours.shape == theirs.shape and np.allclose(ours, theirs)


def _load_objects(folder: Path) -> Catalogue:
    path = folder / "objects.json"
    return objects_from_json(read_json(path), str(path))


def load_state(folder: Path) -> RunState:
    """Where the run of a checkpoint stood.

    Raises:
        DataError: state.json is missing or is not as this program writes it.
    """
    path = folder / "state.json"
    content: Any = read_json(path)
    try:
        return RunState(**content)
    except TypeError as error:
        raise DataError(f"{path} is not the state of a run: {error}.") from error


def restore(folder: Path, model: nn.Module, average: MovingAverage, optimizer: torch.optim.Optimizer) -> RunState:
    """Loads a checkpoint into a freshly built run, random states included, and returns where it stands.

    Raises:
        DataError, ModelError: the folder is no checkpoint, or does not fit the network.
    """
    state = load_state(folder)
    try:
        model.load_state_dict(_read_tensors(folder / "model.safetensors"))
        average.model.load_state_dict(_read_tensors(folder / "ema.safetensors"))
    except RuntimeError as error:
        raise ModelError(f"{folder} holds another network than the configuration says: {error}") from error
    average.updates = state.ema_updates
    tensors = _read_tensors(folder / "training.safetensors")
    for name, parameter in model.named_parameters():
        moments = {key.split("/")[0]: value for key, value in tensors.items() if key.endswith(f"/{name}")}
        if moments:
            # The fused optimiser walks through memory: moments must lie there in the order of their parameter.
            optimizer.state[parameter] = {
                k: v.clone() if k == "step" else torch.empty_like(parameter).copy_(v) for k, v in moments.items()
            }
    torch.set_rng_state(tensors["random/cpu"])
    if torch.cuda.is_available() and "random/cuda" in tensors:
        torch.cuda.set_rng_state(tensors["random/cuda"])
    return state


def take_over(folder: Path, model: nn.Module) -> list[str]:
    """Gives a fresh network the averaged weights of a checkpoint of another training, of other classes maybe.

    Returns:
        Names of the tensors that stay as they were, for those of the checkpoint have other shapes or are not there.

    Raises:
        DataError: the folder is no checkpoint, or damaged.
        ModelError: less than half of the network's numbers are in it.
    """
    find_checkpoint(folder)
    theirs, ours = _read_tensors(folder / "ema.safetensors"), model.state_dict()
    fitting = {n: t for n, t in theirs.items() if n in ours and ours[n].shape == t.shape}
    taken, all_of_it = (sum(ours[n].numel() for n in names) for names in (fitting, ours))
    if 2 * taken < all_of_it:
        there = load_model_config(folder)
        convolutions = "depthwise" if there.depthwise else "plain"
        raise ModelError(
            f"{folder} holds a {there.size} network with {convolutions} convolutions, the neck {there.neck}, strides "
            f"{there.strides} and {there.bins} bins; only {taken / all_of_it:.0%} of the network of this configuration "
            "is in it. Choose the same size, convolutions and neck, or leave `initial` out."
        )
    model.load_state_dict(fitting, strict=False)
    return [name for name in ours if name not in fitting]


def _training_tensors(model: nn.Module, optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    tensors = {"random/cpu": torch.get_rng_state()}
    if torch.cuda.is_available():
        tensors["random/cuda"] = torch.cuda.get_rng_state()
    for name, parameter in model.named_parameters():
        for key, value in optimizer.state.get(parameter, {}).items():
            tensors[f"{key}/{name}"] = value
    return _contiguous(tensors)


def _contiguous(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}


def _read_tensors(path: Path) -> dict[str, Tensor]:
    require_file(path, "checkpoint file")
    try:
        return load_file(path)
    except SafetensorError as error:
        raise DataError(f"{path} is damaged ({error}); use another checkpoint.") from error
