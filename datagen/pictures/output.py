"""An output folder: whose it is, and the models that go into it."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

from multicam.config import load_config, save_config, to_mapping
from multicam.errors import DataError
from multicam.files import write_bytes

Config = TypeVar("Config")
"""A frozen dataclass."""


def claim(path: Path, config: Config, free: Sequence[str]) -> None:
    """Saves the configuration beside its output, or makes sure that the one already there is the same.

    Args:
        free: fields that may have changed since.

    Raises:
        DataError: the folder belongs to another configuration.
    """
    if path.is_file():
        old, new = to_mapping(load_config(type(config), path)), to_mapping(config)
        changed = ", ".join(key for key in new if new[key] != old[key] and key not in free)
        if changed:
            raise DataError(
                f"{path.parent} holds pictures of another configuration (different: {changed}); give another "
                "output, or delete the folder."
            )
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
