"""An output folder: whose it is, and the models that go into it."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

from datagen import GENERATOR_VERSION
from multicam.config import load_config, save_config, to_mapping
from multicam.errors import DataError
from multicam.files import find_leftovers, read_json, write_bytes, write_json

Config = TypeVar("Config")
"""A frozen dataclass."""


def claim(path: Path, config: Config, free: Sequence[str]) -> None:
    """Saves the configuration beside its output, or makes sure that the one already there is the same.

    The version of the generator stands in generator.json, and may not change either.

    Args:
        free: fields that may have changed since.

    Raises:
        DataError: the folder belongs to another configuration, or another version began it.
    """
    version = path.parent / "generator.json"
    if path.is_file():
        began = read_json(version)["version"] if version.is_file() else 1
        if began != GENERATOR_VERSION:
            raise DataError(
                f"{path.parent} was begun by version {began} of the generator, and this is version "
                f"{GENERATOR_VERSION}, whose pictures differ; give another output, or delete the folder."
            )
        old, new = to_mapping(load_config(type(config), path)), to_mapping(config)
        changed = ", ".join(key for key in new if new[key] != old[key] and key not in free)
        if changed:
            raise DataError(
                f"{path.parent} holds pictures of another configuration (different: {changed}); give another "
                "output, or delete the folder."
            )
    for leftover in find_leftovers(path.parent, recursive=False):
        leftover.unlink(missing_ok=True)
    write_json(version, {"version": GENERATOR_VERSION})
    save_config(config, path)


def copy_models(source: Path, target: Path) -> None:
    """Copies a BOP models folder unless it is there already; models_info.json comes last and completes it.

    Raises:
        DataError: other models are there.
    """
    info = (source / "models_info.json").read_bytes()
    there = target / "models_info.json"
    if there.is_file():
        if there.read_bytes() != info:
            raise DataError(f"{target} holds other models than {source}; give another output folder.")
        return
    shutil.copytree(source, target, dirs_exist_ok=True, ignore=lambda *_: ["models_info.json"])
    write_bytes(there, info)
