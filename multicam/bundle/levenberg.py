"""Levenberg-Marquardt on anything that can linearise and retract; it knows neither cameras nor objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from multicam.types import FloatArray

_LARGEST_DAMPING = 1e10
"""Beyond it a step is too short to matter: the state is a minimum to rounding."""


class NormalSystem(Protocol):
    """A problem linearised at one state."""

    def solve(self, damping: float) -> FloatArray:
        """The step (n,) for a damping relative to the diagonal."""
        ...


State = TypeVar("State")
System_co = TypeVar("System_co", bound=NormalSystem, covariant=True)


class LeastSquares(Protocol[State, System_co]):
    """A problem to minimise."""

    def linearize(self, state: State) -> tuple[float, System_co]:
        """Energy and normal equations."""
        ...

    def retract(self, state: State, step: FloatArray) -> State:
        """The state moved by a step."""
        ...


@dataclass(frozen=True)
class LevenbergConfig:
    """When to stop, and how to damp."""

    iterations: int = 20
    """Most linearisations after the first."""
    tolerance: float = 1e-4
    """Largest entry of a step, radians or metres, after which the minimum counts as reached."""
    damping: float = 1e-4
    """First damping, relative to the diagonal."""


@dataclass(frozen=True, eq=False)
class Minimum(Generic[State, System_co]):
    """Where the minimisation ended.

    Attributes:
        system: normal equations at `state`.
        energies: of the accepted states, the first included; they never rise.
    """

    state: State
    system: System_co
    energies: tuple[float, ...]


def minimize(
    problem: LeastSquares[State, System_co], state: State, config: LevenbergConfig
) -> Minimum[State, System_co]:
    """Takes damped Gauss-Newton steps; the damping falls tenfold after a success and rises tenfold after a failure."""
    energy, system = problem.linearize(state)
    energies, damping = [energy], config.damping
    for _ in range(config.iterations):
        step = system.solve(damping)
        moved = problem.retract(state, step)
        lower, next_system = problem.linearize(moved)
        if lower <= energy:
            state, energy, system = moved, lower, next_system
            energies.append(energy)
            damping /= 10
        elif damping > _LARGEST_DAMPING:
            break
        else:
            damping *= 10
        if np.abs(step).max(initial=0) < config.tolerance:
            break
    return Minimum(state, system, tuple(energies))
