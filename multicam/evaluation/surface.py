"""Visible surface discrepancy (Hodan et al. 2016, 2018): how the visible surface differs between two poses.

Everything is in distances from the camera's centre, metres, as (h, w) images; 0 is where nothing is known or drawn.
With S the measured scene, T the object drawn in the true pose and E in the estimated one, the object is visible

    in T where  T - S <= delta  or S is unknown,
    in E where  E - S <= delta  or S is unknown  or T is visible there,

and the error for a tolerance tau is the share of the union of both that is in one only or differs by tau or more.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import render_depth
from multicam.types import FloatArray

DELTA = 0.015
"""Metres by which a surface may lie behind the measured one and still count as visible (BOP; ITODD alone uses 5 mm)."""

TAUS = tuple(np.arange(1, 11) * 0.05)
"""Tolerances tau as shares of the diameter: 5 % to 50 % (BOP)."""


def distances(depth: Float[np.ndarray, "h w"], camera: Camera) -> FloatArray:
    """Depth along the optical axis as distance from the camera's centre; 0 stays 0."""
    rows, columns = np.indices(depth.shape, dtype=np.float64)
    rays = camera.unproject(np.stack((columns, rows), axis=-1))
    return depth * np.linalg.norm(rays, axis=-1)


def drawn_distances(mesh: Mesh, camera: Camera, camera_from_object: FloatArray) -> FloatArray:
    """An object alone, as `distances`."""
    return distances(render_depth(mesh, camera, camera_from_object), camera)


def vsd(estimated: FloatArray, true: FloatArray, scene: FloatArray, diameter: float) -> FloatArray:
    """Errors (10,) in [0, 1] for the tolerances TAUS; 1 where the object is visible in neither pose.

    Args:
        estimated, true: (h, w) distances of the object drawn in both poses.
        scene: (h, w) measured distances.
        diameter: of the object, metres.
    """
    in_true = _visible(true, scene)
    in_estimated = _visible(estimated, scene) | (in_true & (estimated > 0))
    both = in_true & in_estimated
    union = np.count_nonzero(in_true | in_estimated)
    if union == 0:
        return np.ones(len(TAUS))
    shifts = np.abs(true[both] - estimated[both]) / diameter
    one_only = union - len(shifts)
    return np.array([(np.count_nonzero(shifts >= tau) + one_only) / union for tau in TAUS])


def _visible(drawn: FloatArray, scene: FloatArray) -> NDArray[np.bool_]:
    return (drawn > 0) & ((drawn - scene <= DELTA) | (scene == 0))
