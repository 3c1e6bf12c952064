"""Viewpoint models that are generated once: kept in a folder under a name that mesh and configuration decide."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TypeVar

from multicam.bundle.viewpoints.generate import ViewpointConfig, generate
from multicam.bundle.viewpoints.model import ViewpointModel, load, save
from multicam.errors import DataError
from multicam.geometry.mesh import Mesh
from multicam.progress import Progress, SilentProgress

Key = TypeVar("Key")

FORMAT = 1
"""To be raised whenever the same mesh and configuration shall give another model or file."""

_logger = logging.getLogger(__name__)


def cache_folder() -> Path:
    """Where generated files are kept: $MULTICAM_CACHE, or ~/.cache/multicam."""
    return Path(os.environ.get("MULTICAM_CACHE") or Path.home() / ".cache" / "multicam")


def load_viewpoints(
    meshes: Mapping[Key, Mesh], config: ViewpointConfig, progress: Progress | None = None, folder: Path | None = None
) -> dict[Key, ViewpointModel]:
    """Models of meshes, mapped from files of the cache; those that are not there yet, or damaged, are generated.

    Args:
        folder: the cache; `cache_folder` if left out.

    Raises:
        DataError: the cache cannot be written, or a mesh has no surface.
    """
    folder = folder or cache_folder()
    shown = (progress or SilentProgress()).track(meshes.items(), "viewpoint models", len(meshes))
    return {key: _load(mesh, config, folder / "viewpoints") for key, mesh in shown}


def _load(mesh: Mesh, config: ViewpointConfig, folder: Path) -> ViewpointModel:
    path = folder / f"{_fingerprint(mesh, config)}.npy"
    if path.exists():
        try:
            return load(path)
        except DataError as error:
            _logger.warning("%s It is generated anew.", error)
    model = generate(mesh, config)
    try:
        save(model, path)
    except OSError as error:
        raise DataError(
            f"The viewpoint model {path} cannot be written: {error.strerror}; set MULTICAM_CACHE to another folder."
        ) from error
    return load(path)


def _fingerprint(mesh: Mesh, config: ViewpointConfig) -> str:
    """Hash of all that a model depends on; colours and textures are no part of it."""
    digest = hashlib.blake2b(digest_size=16)
    digest.update(json.dumps((FORMAT, mesh.vertices.shape, mesh.faces.shape, asdict(config)), sort_keys=True).encode())
    digest.update(mesh.vertices.astype("<f8").tobytes())
    digest.update(mesh.faces.astype("<i8").tobytes())
    return digest.hexdigest()
