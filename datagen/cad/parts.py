"""`parts.yaml`: which files of a folder are which objects, in which unit, with which symmetries."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from datagen.cad.turns import Turn, from_turns
from datagen.cad.units import METRES, Unit, in_every_unit
from multicam.config import from_mapping, read_yaml
from multicam.dataset.objects import MESH_SUFFIXES
from multicam.errors import ConfigError, DataError, did_you_mean
from multicam.files import require_folder, write_text
from multicam.geometry.mesh import load_mesh
from multicam.geometry.symmetry import Symmetries

FILE = "parts.yaml"
_BESIDE = (".mtl", ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".json")
"""Files beside the meshes that change what is imported."""


@dataclass(frozen=True)
class AxisConfig:
    """An axis of symmetry; the turns of all axes of a part, and their products, are its symmetries."""

    axis: tuple[float, float, float]
    """Direction in the part's own frame, of any length."""
    fold: int = 0
    """How many turns make a circle: 2 for a half turn, 6 for a hexagon."""
    continuous: bool = False
    """Any angle, instead of `fold`."""
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """A point on the axis, in the unit of the part."""

    def __post_init__(self) -> None:
        if not any(self.axis):
            raise ValueError("an axis of symmetry needs a direction that is not zero")
        if self.continuous == (self.fold != 0) or not (self.continuous or 2 <= self.fold <= 36):
            raise ValueError("an axis of symmetry has either `fold`, from 2 to 36, or `continuous: true`")


@dataclass(frozen=True)
class PartConfig:
    """One object."""

    file: str
    """Mesh, relative to the folder of parts.yaml."""
    name: str = ""
    """Of the class; the file's own without suffix if left out."""
    obj_id: int | None = None
    """Number of the class, from 1; that of a file like obj_000005.ply, else its place in the list, if left out."""
    unit: Unit | None = None
    """Of this part, where it differs from the folder's."""
    symmetries: tuple[AxisConfig, ...] | None = None
    """Axes, or `none`; left out, they are proposed from the shape."""

    def stated(self, default: Unit) -> Symmetries | None:
        """The symmetries as stated, metres, or None where they are to be proposed.

        Raises:
            ConfigError: the axes do not make a finite group.
        """
        if self.symmetries is None:
            return None
        scale = METRES[self.unit or default]
        turns = [
            Turn(np.array(a.axis) / np.linalg.norm(a.axis), np.array(a.offset) * scale, a.fold) for a in self.symmetries
        ]
        found = from_turns(turns)
        if found is None:
            raise ConfigError(f"the axes of symmetry of {self.file} do not fit together: their turns have no end.")
        return found


@dataclass(frozen=True)
class PartsConfig:
    """The file as a whole."""

    unit: Unit
    """Of the numbers in the mesh files; it is never guessed."""
    parts: tuple[PartConfig, ...] = ()
    """Which files; all of the folder if left out."""
    assemblies: str | None = None
    """JSON file of mounted groups, relative to the folder, in BOP's millimetres; see docs/datagen.md."""


def parts_file(path: Path) -> Path:
    """The parts.yaml that a path means: itself, or the one in it."""
    return path / FILE if path.is_dir() else path


def read_parts(path: Path) -> PartsConfig:
    """Reads parts.yaml; every part gets its name and number.

    Raises:
        ConfigError: the file is missing (the sentence says what to write), or something in it does not fit.
        DataError: a mesh that it names is missing.
    """
    folder = require_folder(path.parent, "folder of CAD files")
    there = mesh_files(folder)
    if not path.is_file():
        listed = ", ".join(there) if there else "none (PLY, OBJ, STL and GLB are read)"
        raise ConfigError(
            f"{path} does not exist; write one that states the unit of the meshes, `unit: mm` for example, or have a "
            f"draft made by `multicam datagen import --parts {path} --suggest`; mesh files there: {listed}."
        )
    mapping = read_yaml(path)
    for part in mapping.get("parts") or ():
        if isinstance(part, dict) and part.get("symmetries") == "none":
            part["symmetries"] = []
    if mapping.get("unit") is None:
        raise ConfigError(_without_unit(path, mapping, there))
    config = from_mapping(PartsConfig, mapping, str(path))
    parts = config.parts or tuple(PartConfig(name) for name in there)
    if not parts:
        raise DataError(f"{folder} holds no mesh files; PLY, OBJ, STL and GLB are read.")
    for part in parts:
        if Path(part.file).is_absolute() or ".." in Path(part.file).parts:
            raise ConfigError(f"{path} names {part.file}; give files within {folder}, relative to it.")
        if not (folder / part.file).is_file():
            listed = ", ".join(there) or "no mesh"
            raise DataError(f"{path} names {part.file}{did_you_mean(part.file, there)}, but {folder} holds {listed}.")
        if Path(part.file).suffix.lower() not in MESH_SUFFIXES:
            raise DataError(f"{path} names {part.file}, which is no mesh; PLY, OBJ, STL and GLB are read.")
    return replace(config, parts=_numbered(parts, path))


def suggest(path: Path) -> None:
    """Writes a draft of parts.yaml: every mesh of the folder with its size in each unit, the unit left open.

    Raises:
        ConfigError: there is one already.
        DataError: the folder holds no meshes, or one cannot be read.
    """
    if path.exists():
        raise ConfigError(f"{path} is there already; edit it, or remove it first.")
    folder = require_folder(path.parent, "folder of CAD files")
    lines = ["# Fill in the unit of the numbers in the mesh files: mm, cm, m or inch.", "unit:", "parts:"]
    files = mesh_files(folder)
    if not files:
        raise DataError(f"{folder} holds no mesh files; PLY, OBJ, STL and GLB are read.")
    for part in _numbered(tuple(PartConfig(name) for name in files), path):
        size = in_every_unit(load_mesh(folder / part.file, 1.0).diameter())
        lines += [f"  # {size}", f"  - file: {part.file}", f"    name: {part.name}", f"    obj_id: {part.obj_id}"]
    lines.append("# Symmetries are proposed from the shape; beside a part, `symmetries: none` or axes overrule that.")
    write_text(path, "\n".join(lines) + "\n")


def mesh_files(folder: Path) -> list[str]:
    """Names of the mesh files in a folder, in order."""
    return sorted(p.name for p in folder.iterdir() if p.is_file() and p.suffix.lower() in MESH_SUFFIXES)


def digest(path: Path, config: PartsConfig) -> str:
    """Changes with anything that an import reads: parts.yaml, the meshes, and materials and pictures beside them."""
    files = {path} | {path.parent / part.file for part in config.parts}
    folders = {file.parent for file in files}
    files |= {p for f in folders for p in f.iterdir() if p.is_file() and p.suffix.lower() in _BESIDE}
    total = hashlib.sha256()
    for file in sorted(files):
        total.update(f"{file.relative_to(path.parent)}\0".encode())
        total.update(hashlib.sha256(file.read_bytes()).digest())
    return total.hexdigest()


def _numbered(parts: tuple[PartConfig, ...], path: Path) -> tuple[PartConfig, ...]:
    """Every part with its name and number."""
    named: list[PartConfig] = []
    for index, part in enumerate(parts):
        number = re.fullmatch(r"obj_(\d{6})", Path(part.file).stem)
        obj_id = part.obj_id if part.obj_id is not None else int(number[1]) if number else index + 1
        if obj_id < 1:
            raise ConfigError(f"{path}: obj_id of {part.file} is {obj_id}; numbers of classes begin with 1.")
        named.append(replace(part, name=part.name or Path(part.file).stem, obj_id=obj_id))
    for what in ("obj_id", "name"):
        seen: dict[Any, str] = {}
        for part in named:
            value = getattr(part, what)
            if value in seen:
                raise ConfigError(f"{path}: {seen[value]} and {part.file} both have the {what} {value}; change one.")
            seen[value] = part.file
    return tuple(named)


def _without_unit(path: Path, mapping: dict[str, Any], there: list[str]) -> str:
    """Says what the unit decides, on the example of the first mesh."""
    named = [str(part["file"]) for part in mapping.get("parts") or () if isinstance(part, dict) and "file" in part]
    file = next((name for name in (*named, *there) if (path.parent / name).is_file()), None)
    size = ""
    if file is not None:
        size = f"; {file} would be {in_every_unit(load_mesh(path.parent / file, 1.0).diameter())}"
    return f"{path} does not state the unit of its meshes: write `unit: mm` (or cm, m, inch) at its top{size}."
