"""What a finished scene folder holds, with hashes: written last, and proof that the scene is whole."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from datagen import GENERATOR_VERSION
from datagen.config import DatagenConfig
from multicam import __version__
from multicam.config import from_mapping, to_mapping
from multicam.files import read_json, write_json

FREE = ("images", "models", "output", "executor", "workers")
"""Fields of a DatagenConfig that may change between the scenes of a data set: they do not change a picture."""


@dataclass(frozen=True)
class FileEntry:
    """Size in bytes and SHA-256 (hexadecimal) of a file."""

    size: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """Of one scene.

    Attributes:
        generator: GENERATOR_VERSION that made it.
        package: version of multicam-pose that made it, for the record.
        config: SHA-256 of the resolved configuration without the fields in FREE.
        models: SHA-256 of models_info.json.
        seed, scene: what everything in the scene was drawn from.
        images: how many pictures it holds, numbered from 0.
        files: by path within the folder, all but this manifest.
    """

    generator: int
    package: str
    config: str
    models: str
    seed: int
    scene: int
    images: int
    files: dict[str, FileEntry]


def manifest_path(folder: Path) -> Path:
    """Where the manifest of a scene folder is."""
    return folder / "manifest.json"


def read_manifest(folder: Path) -> Manifest | None:
    """The manifest of a scene folder; None if the scene is not finished.

    Raises:
        DataError: it is not JSON.
        ConfigError: it is no manifest.
    """
    path = manifest_path(folder)
    return from_mapping(Manifest, read_json(path), str(path)) if path.is_file() else None


def write_manifest(folder: Path, config: DatagenConfig, scene: int) -> None:
    """Finishes a scene folder that holds all its pictures."""
    manifest = Manifest(
        generator=GENERATOR_VERSION,
        package=__version__,
        config=_hash_config(config),
        models=entry_of(config.models / "models_info.json").sha256,
        seed=config.seed,
        scene=scene,
        images=config.images_in_scene(scene),
        files={str(path.relative_to(folder)): entry_of(path) for path in list_files(folder)},
    )
    write_json(manifest_path(folder), to_mapping(manifest), indent=1)


def list_files(folder: Path) -> Iterable[Path]:
    """Every file of a scene folder but its manifest and hidden ones, in order."""
    return sorted(
        path
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith(".") and path != manifest_path(folder)
    )


def entry_of(path: Path) -> FileEntry:
    """Size and hash of a file as it is now."""
    data = path.read_bytes()
    return FileEntry(len(data), hashlib.sha256(data).hexdigest())


def _hash_config(config: DatagenConfig) -> str:
    fixed = {key: value for key, value in to_mapping(config).items() if key not in FREE}
    return hashlib.sha256(json.dumps(fixed, sort_keys=True).encode()).hexdigest()
