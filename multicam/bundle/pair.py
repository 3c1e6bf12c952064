"""What a factor between two cameras is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from multicam.geometry import se3
from multicam.matching.arrays import IntArray
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class PairLinearization:
    """Second-order model of energies that depend on two poses each, in the right tangents of both.

    Attributes:
        energy: (m,).
        gradient: (m, 12), of the first pose and then of the second.
        hessian: (m, 12, 12) positive semidefinite (Gauss-Newton).
    """

    energy: FloatArray
    gradient: FloatArray
    hessian: FloatArray


class PairFactor(Protocol):
    """Ties between cameras; tie k holds first[k] and second[k] together."""

    @property
    def first(self) -> IntArray:
        """(m,) index of the first camera."""
        ...

    @property
    def second(self) -> IntArray:
        """(m,) index of the second camera."""
        ...

    def linearize(self, world_from_camera: FloatArray) -> PairLinearization:
        """At the poses (c, 4, 4) of all cameras, robust weights included."""
        ...


def relative_poses(world_from_camera: FloatArray, first: IntArray, second: IntArray) -> tuple[FloatArray, FloatArray]:
    """first_from_second (m, 4, 4), and (m, 6, 12) how it moves, on the right, with both poses.

    A motion of the second pose moves it by the same, one of the first by minus Ad(second_from_first) times that.
    """
    relative = se3.inverse(world_from_camera[first]) @ world_from_camera[second]
    identity = np.broadcast_to(np.eye(6), (len(first), 6, 6))
    return relative, np.concatenate((-se3.adjoint(se3.inverse(relative)), identity), axis=-1)
