"""All that can be put into a scene: meshes, the bodies they form, nominal colours, mounted groups."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datagen.scenes.layout import Body, body_of
from datagen.scenes.spec import Color
from multicam.dataset.objects import MILLIMETRE, Catalogue, load_catalogue
from multicam.errors import DataError
from multicam.files import read_json
from multicam.geometry import se3
from multicam.geometry.mesh import Mesh
from multicam.types import FloatArray

_GREY: Color = (0.6, 0.6, 0.62)
_ONE_COLOR = 3.0
"""Standard deviation of vertex colours, of 255, up to which they are one colour."""


@dataclass(frozen=True, eq=False)
class Group:
    """Parts mounted together: (obj_id, group_from_object) each, and the body they form."""

    parts: tuple[tuple[int, FloatArray], ...]
    body: Body


@dataclass(frozen=True, eq=False)
class Stock:
    """All that can be put into a scene.

    Attributes:
        colors: nominal linear colour of each class.
        painted: classes whose meshes have a texture, or vertex colours that differ.
    """

    catalogue: Catalogue
    meshes: dict[int, Mesh]
    bodies: dict[int, Body]
    colors: dict[int, Color]
    painted: frozenset[int]
    groups: tuple[Group, ...]


def load_stock(models: Path) -> Stock:
    """Reads a BOP models folder with meshes, and assemblies.json where there is one.

    Raises:
        DataError: files missing or malformed.
    """
    catalogue = load_catalogue(models)
    meshes = {obj_id: catalogue[obj_id].load_mesh() for obj_id in catalogue.obj_ids}
    # The points that stand for a surface must not depend on the seed of a data set.
    rng = np.random.default_rng(0)
    bodies = {obj_id: body_of([mesh], rng) for obj_id, mesh in meshes.items()}
    colors = {obj_id: _nominal_color(mesh) for obj_id, mesh in meshes.items()}
    path = models / "assemblies.json"
    groups: list[Group] = []
    for row in read_json(path) if path.is_file() else []:
        try:
            parts = tuple(_read_part(part) for part in row["parts"])
            placed = [Mesh(se3.act(pose, meshes[i].vertices), meshes[i].faces) for i, pose in parts]
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(f"{path} does not follow the format of assemblies: {error!r}.") from error
        groups.append(Group(parts, body_of(placed, rng)))
    painted = frozenset(obj_id for obj_id, mesh in meshes.items() if _is_painted(mesh))
    return Stock(catalogue, meshes, bodies, colors, painted, tuple(groups))


def _is_painted(mesh: Mesh) -> bool:
    return mesh.texture is not None or (mesh.colors is not None and float(mesh.colors.std(axis=0).max()) > _ONE_COLOR)


def _nominal_color(mesh: Mesh) -> Color:
    """Mean vertex colour as linear RGB; steel grey for meshes without colours."""
    if mesh.colors is None:
        return _GREY
    r, g, b = (float(v) for v in (mesh.colors.mean(0) / 255) ** 2.2)
    return r, g, b


def _read_part(row: dict[str, Any]) -> tuple[int, FloatArray]:
    rotation = np.array(row["R_group_from_object"], dtype=np.float64).reshape(3, 3)
    translation = np.array(row["t_group_from_object"], dtype=np.float64) * MILLIMETRE
    return int(row["obj_id"]), se3.from_parts(rotation, translation)
