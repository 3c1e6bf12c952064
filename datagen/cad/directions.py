"""Directions in which an axis of symmetry may lie, each once up to its sign."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np

from datagen.cad.surface import Surface
from multicam.types import FloatArray

_SAME = np.cos(np.deg2rad(5))
_LEAST = 0.02
"""Share of the surface that faces a direction that counts."""
_FACES = 12
_RING, _GRID = 36, 400
"""Directions in a half circle (5 degrees apart) and on a half sphere (about 7)."""


def face_directions(surface: Surface) -> FloatArray:
    """(n, 3) where flat parts of the surface face, and the bisectors of two and of three of them.

    The axes of a cube, for example, are its face normals, their sums by twos (edges) and by threes (corners).
    """
    normals = surface.normals[:1000]
    left = normals
    found: list[FloatArray] = []
    while len(left) > _LEAST * len(normals) and len(found) < _FACES:
        same = np.abs(left @ left.T) > _SAME
        best = int(same.sum(1).argmax())
        if same[best].sum() < _LEAST * len(normals):
            break
        cluster = left[same[best]]
        mean = (cluster * np.sign(cluster @ left[best])[:, None]).sum(0)
        found.append(mean / np.linalg.norm(mean))
        left = left[~same[best]]
    sums = list(found)
    for count, most in ((2, _FACES), (3, 6)):
        for chosen in combinations(found[:most], count):
            for signs in product((1, -1), repeat=count - 1):
                sums.append(chosen[0] + sum((s * c for s, c in zip(signs, chosen[1:], strict=True)), np.zeros(3)))
    rows = np.array(sums).reshape(-1, 3)
    lengths = np.linalg.norm(rows, axis=1)
    rows = rows[lengths > 0.1] / lengths[lengths > 0.1, None]
    kept: list[FloatArray] = []
    for row in rows:
        if not any(abs(row @ other) > np.cos(np.deg2rad(1)) for other in kept):
            kept.append(row)
    return np.array(kept).reshape(-1, 3)


def around(direction: FloatArray) -> FloatArray:
    """(36, 3) directions at right angles to one, 5 degrees apart."""
    first = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    angle = np.pi * np.arange(_RING) / _RING
    return np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second


def everywhere() -> FloatArray:
    """(400, 3) directions spread over a half sphere along a Fibonacci spiral."""
    z = (np.arange(_GRID) + 0.5) / _GRID
    angle = np.pi * (1 + 5**0.5) * np.arange(_GRID)
    radius = np.sqrt(1 - z * z)
    return np.stack((radius * np.cos(angle), radius * np.sin(angle), z), axis=-1)
