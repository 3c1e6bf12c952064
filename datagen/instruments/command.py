"""`multicam datagen models`: writes the CAD of the nine instruments as a BOP models folder."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

from datagen.instruments.write import write_models
from multicam.config import parse_command, save_config
from multicam.errors import ConfigError
from multicam.progress import RichProgress

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class ModelsConfig:
    """Options of `multicam datagen models`."""

    output: Path
    """Folder that receives the meshes, models_info.json, keypoints.json and assemblies.json."""
    keypoints: int = 8
    """Keypoints per object."""
    seed: int = 0
    """Seed of the surface samples that the keypoints are chosen from."""
    picture: Path | None = None
    """PNG file for a picture of all nine parts; needs bpy."""
    samples: int = 48
    """Light paths per pixel of the picture."""

    def __post_init__(self) -> None:
        if self.keypoints < 4:
            raise ConfigError(f"keypoints is {self.keypoints}, but a pose needs at least 4; ask for 4 or more.")
        if self.seed < 0:
            raise ConfigError(f"seed is {self.seed}; give zero or a positive whole number.")
        if self.samples < 1:
            raise ConfigError(f"samples is {self.samples}; a picture needs at least 1.")


def main(argv: list[str]) -> None:
    """Runs the command.

    Raises:
        ConfigError: an option does not fit.
        MissingDependencyError: a picture was asked for, and bpy is not installed.
    """
    config = parse_command(
        ModelsConfig, argv, "multicam datagen models", "Writes the nine instruments as a BOP models folder."
    )
    progress = RichProgress()
    write_models(config.output, config.keypoints, config.seed, progress)
    save_config(config, config.output / "config.yaml")
    _LOG.info("wrote the instruments to %s", config.output)
    if config.picture is not None:
        from datagen.instruments.picture import write_picture

        write_picture(config.output, config.picture, config.samples, progress)
        _LOG.info("wrote the picture to %s", config.picture)
