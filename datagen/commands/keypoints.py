"""`multicam datagen keypoints`: adds farthest-point keypoints to a BOP models folder of one's own."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multicam.config import parse_command
from multicam.dataset.bop_writer import keypoint_table
from multicam.dataset.objects import load_catalogue
from multicam.errors import ConfigError, DataError
from multicam.files import write_json
from multicam.geometry.keypoints import sample_keypoints
from multicam.progress import Progress, RichProgress

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class KeypointsConfig:
    """Options of `multicam datagen keypoints`."""

    models: Path
    """BOP models folder with meshes and models_info.json; keypoints.json is written into it."""
    count: int = 8
    """Keypoints per object."""
    seed: int = 0
    """Seed of the surface samples that the keypoints are chosen from."""
    replace: bool = False
    """Write new keypoints where there are some; networks trained on the old ones no longer fit."""

    def __post_init__(self) -> None:
        if self.count < 4:
            raise ConfigError(f"count is {self.count}, but a pose needs at least 4 keypoints; ask for 4 or more.")


def main(argv: list[str]) -> None:
    """Runs the command."""
    config = parse_command(
        KeypointsConfig, argv, "multicam datagen keypoints", "Adds farthest-point keypoints to a BOP models folder."
    )
    write_keypoints(config, RichProgress())
    _LOG.info("wrote %s", config.models / "keypoints.json")


def write_keypoints(config: KeypointsConfig, progress: Progress) -> None:
    """Samples the keypoints of every object and writes keypoints.json (mm).

    Raises:
        DataError: a mesh is missing or in the wrong unit, or keypoints are there already.
    """
    target = config.models / "keypoints.json"
    if target.exists() and not config.replace:
        raise DataError(f"{target} exists; --replace writes it anew, but trained networks depend on it.")
    objects = load_catalogue(config.models).objects.values()
    keypoints = {
        model.obj_id: sample_keypoints(model.load_mesh(), config.count, np.random.default_rng(config.seed))
        for model in progress.track(objects, "keypoints", total=len(objects))
    }
    write_json(target, keypoint_table(keypoints), indent=1)
