"""What a factor is: something that a camera says about the pose of an object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from multicam.bundle.robust import Student
from multicam.matching.arrays import IntArray
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class Linearization:
    """Second-order model of the energy of each edge in the right tangent of its pose, before any robust weight.

    Attributes:
        energy: (e,) half the squared whitened residual.
        gradient: (e, 6).
        hessian: (e, 6, 6) positive semidefinite (Gauss-Newton).
    """

    energy: FloatArray
    gradient: FloatArray
    hessian: FloatArray


class EdgeFactor(Protocol):
    """Edges between cameras and objects; edge e ties camera[e] to object[e]."""

    @property
    def camera(self) -> IntArray:
        """(e,) index of the camera."""
        ...

    @property
    def object(self) -> IntArray:
        """(e,) index of the object."""
        ...

    @property
    def kernel(self) -> Student:
        """Robust cost that is applied to each edge."""
        ...

    def linearize(self, camera_from_object: FloatArray) -> Linearization:
        """Energy, gradient and Hessian at poses (e, 4, 4), in the right tangent of `camera_from_object`."""
        ...
