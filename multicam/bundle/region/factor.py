"""Factor of correspondence lines: the contour of an object against the colours of a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from multicam.bundle.factor import Linearization
from multicam.bundle.groups import laid_out
from multicam.bundle.region.compiled import LINE, linearize_lines
from multicam.bundle.region.config import RegionConfig
from multicam.bundle.region.lines import LineArray
from multicam.bundle.robust import PLAIN, Student
from multicam.matching.arrays import IntArray
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class RegionFactor:
    """Lines found once, at whatever pose they are then evaluated; one edge for each object in each picture.

    The energy of an edge is -sum w ln(p(d) / max p) over its lines, where the shift d of the contour along a line
    depends on the pose and ln p is interpolated between shifts, constant beyond them. It is infinite where a line would
    fall behind the camera. Two quadratic models of it exist (Stoiber et al., SRT3D, IJCV 2022, sections 3.4 and 3.5):
    the global one is that of a normal distribution with the posterior's mean and variance, its gradient
    w (d - mean) / variance; the local one follows the posterior's own slope, its gradient is that of the energy times
    gain / variance on each line, and lines beyond the shifts leave it. Both have the curvature w / variance.

    Attributes:
        camera, object: (e,) what each edge ties.
        camera_matrix: (e, 3, 3) of an ideal lens.
        lines: of all edges, one edge after the other.
        start: (e + 1,) where the lines of each edge begin, and the end.
        local: which model is used.
        gain: see RegionConfig.
        kernel: robust cost of one edge.
    """

    camera: IntArray
    object: IntArray
    camera_matrix: FloatArray
    lines: LineArray
    start: IntArray
    local: bool
    gain: float
    kernel: Student = PLAIN

    @classmethod
    def of_edges(
        cls,
        camera: IntArray,
        obj: IntArray,
        camera_matrix: FloatArray,
        lines: Sequence[LineArray],
        config: RegionConfig,
    ) -> RegionFactor:
        """Edges with the lines of each, for the first update after their search."""
        factor = cls(camera, obj, camera_matrix, *laid_out(lines, LINE), local=False, gain=config.gain)
        return factor.in_update(0, config)

    def in_update(self, update: int, config: RegionConfig) -> RegionFactor:
        """The same lines as they are used in the update of that number, from 0, after their search."""
        return replace(self, local=update >= config.global_updates)

    def linearize(self, camera_from_object: FloatArray) -> Linearization:
        """See EdgeFactor. dd/dxi = dd/dX R [-hat(X), I]."""
        count = len(camera_from_object)
        energy, gradient, hessian = np.empty(count), np.empty((count, 6)), np.empty((count, 6, 6))
        linearize_lines(
            self.lines, self.start, self.camera_matrix, camera_from_object, self.local, self.gain,
            energy, gradient, hessian,
        )  # fmt: skip
        return Linearization(energy, gradient, hessian)
