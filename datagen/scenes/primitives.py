"""Unit primitives for tables, walls and distractors: one box edge long, centred, scaled by their user."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from multicam.geometry.mesh import Mesh

SHAPES = ("box", "cylinder", "cone", "sphere", "torus")


@cache
def primitive(shape: str) -> Mesh:
    """The mesh of a shape in SHAPES; its bounding box is the unit cube about the origin (a torus is flatter)."""
    from trimesh import creation

    makers: dict[str, Callable[[], Any]] = {
        "box": lambda: creation.box((1, 1, 1)),
        "cylinder": lambda: creation.cylinder(radius=0.5, height=1, sections=32),
        "cone": lambda: creation.cone(radius=0.5, height=1, sections=32),
        "sphere": lambda: creation.icosphere(subdivisions=3, radius=0.5),
        "torus": lambda: creation.torus(major_radius=0.375, minor_radius=0.125),
    }
    made = makers[shape]()
    vertices = np.asarray(made.vertices, dtype=np.float64)
    vertices = vertices - (vertices.min(0) + vertices.max(0)) / 2
    return Mesh(vertices, np.asarray(made.faces, dtype=np.int64))
