"""The estimates of a group of views as arrays, ready for vectorised matching."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.errors import DataError
from multicam.matching.arrays import BoolArray, IntArray
from multicam.matching.learned import NoiseModel
from multicam.matching.linear import inverse
from multicam.matching.noise import NoiseConfig, free_turns, geometric_covariance
from multicam.types import FloatArray, View

CREDIBLE = (1e-4, 0.98)
"""Scores as probabilities: published files state 1.0 throughout, and no detector is that sure, or that unsure."""


@dataclass(frozen=True, eq=False)
class PosedObjects:
    """Objects with poses in one or several frames: estimates in their cameras, or fused objects in a world.

    Attributes:
        frame: (n,) index of the frame, ascending.
        obj_id: (n,) class.
        score: (n,) probability in [0, 1] that the object is there.
        frame_from_object: (n, 4, 4).
        covariance: (n, 6, 6) of the right perturbation; a turn about a symmetry axis has that of a free angle.
    """

    frame: IntArray
    obj_id: IntArray
    score: FloatArray
    frame_from_object: FloatArray
    covariance: FloatArray

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, chosen: IntArray | BoolArray) -> PosedObjects:
        return PosedObjects(
            self.frame[chosen], self.obj_id[chosen], self.score[chosen],
            self.frame_from_object[chosen], self.covariance[chosen],
        )  # fmt: skip


def observe(
    views: Sequence[View], catalogue: Catalogue, config: NoiseConfig, noise: NoiseModel | None = None
) -> PosedObjects:
    """Collects the estimates; where one has no covariance, the geometric noise model gives it.

    The frame of an estimate is the index of its view; estimates keep their order. A learnt noise model corrects depths
    and scales covariances, stated ones too.

    Raises:
        DataError: an estimate of a class that the catalogue does not hold, or with a covariance that is none.
    """
    flat = [(v, estimate) for v, view in enumerate(views) for estimate in view.estimates]
    models = [catalogue[estimate.obj_id] for _, estimate in flat]
    poses = np.array([e.camera_from_object for _, e in flat]).reshape(-1, 4, 4)
    obj_id = np.array([e.obj_id for _, e in flat], dtype=np.int64)
    covariance = np.zeros((len(flat), 6, 6))
    silent = [n for n, (_, e) in enumerate(flat) if e.covariance is None]
    if silent:
        corners = np.array([models[n].box_corners() for n in silent])
        focal = np.array([_focal(views[flat[n][0]], config) for n in silent])
        covariance[silent] = geometric_covariance(poses[silent], corners, focal, config)
    for n, (view, estimate) in enumerate(flat):
        if estimate.covariance is not None:
            covariance[n] = _checked(estimate.covariance, estimate.obj_id, views[view].view_id)
    if noise is not None:
        centre = np.array([model.box_centre() for model in models]).reshape(-1, 3)
        poses, covariance = noise.apply(obj_id, poses, centre, covariance)
    for n, model in enumerate(models):
        if model.symmetries.axes:
            covariance[n] += free_turns(model)
    return PosedObjects(
        frame=np.array([v for v, _ in flat], dtype=np.int64),
        obj_id=obj_id,
        score=np.clip(np.array([e.score for _, e in flat], dtype=np.float64), *CREDIBLE),
        frame_from_object=poses,
        covariance=covariance,
    )


def _checked(covariance: FloatArray, obj_id: int, view_id: str) -> FloatArray:
    try:
        inverse(covariance)
    except np.linalg.LinAlgError as error:
        raise DataError(
            f"the estimate of object {obj_id} in view {view_id} states a covariance that is not positive definite; "
            "state the variances of all six directions, or none at all."
        ) from error
    return covariance


def _focal(view: View, config: NoiseConfig) -> float:
    if view.camera_matrix is None:
        return config.assumed_focal
    (a, b), (c, d) = view.camera_matrix[:2, :2].tolist()
    return math.sqrt(abs(a * d - b * c))
