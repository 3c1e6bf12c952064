"""One label per picture for objects that look the same in several poses.

Of all poses T @ S that give the same picture, the target is the one whose rotation, seen along the ray to the object,
is closest to the object's canonical view (Merrill et al. 2022, "Symmetry and uncertainty-aware object SLAM").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.dataset.objects import ObjectModel
from multicam.geometry import se3
from multicam.geometry.symmetry import Symmetries
from multicam.types import FloatArray

_SAMPLES = 96
"""Training poses from which the canonical view is chosen, and which are tried as such."""


@dataclass(frozen=True, eq=False)
class CanonicalView:
    """How the poses of one object are made unique.

    Attributes:
        symmetries: of the object.
        centre: (3,) point of the object that no symmetry moves, metres.
        view: (3, 3) rotation of the object in its canonical view; None where there is nothing to choose, for want of
            symmetries or of pictures.
    """

    symmetries: Symmetries
    centre: FloatArray
    view: FloatArray | None

    def canonical(self, camera_from_object: FloatArray) -> FloatArray:
        """The canonical one (N, 4, 4) among the poses equivalent to each of (N, 4, 4).

        Raises:
            ValueError: the object has symmetries, but no view was chosen.
        """
        if not self.symmetries:
            return camera_from_object
        if self.view is None:
            raise ValueError("no canonical view was chosen, for no picture showed the object")
        seen = se3.from_parts(allocentric(camera_from_object, self.centre), np.zeros((len(camera_from_object), 3)))
        target = se3.from_parts(self.view, np.zeros(3))
        # An infinite extent leaves translation out: offsets of symmetry axes say nothing about rotation.
        return camera_from_object @ self.symmetries.closest(target, seen, extent=np.inf)


def canonical_view(model: ObjectModel, camera_from_objects: FloatArray) -> CanonicalView:
    """The canonical view: of the training poses (N, 4, 4), the most central one up to symmetry.

    Labels jump where two equivalent poses are equally far from the canonical view. The most central view (least mean
    of fourth powers of the chordal distance) keeps these places away from where the pictures are.
    """
    centre = invariant_centre(model)
    if not model.symmetries or not len(camera_from_objects):
        return CanonicalView(model.symmetries, centre, None)
    chosen = np.unique(np.linspace(0, len(camera_from_objects) - 1, _SAMPLES).astype(int))
    views = allocentric(camera_from_objects[chosen], centre)
    turns = model.symmetries.transforms()[:, :3, :3]
    # trace(V' R S) for every candidate V, pose R and symmetry S; the greatest over S is the closest label.
    closeness = np.einsum("vij,rik,skj->vrs", views, views, turns, optimize=True).max(axis=2)
    return CanonicalView(model.symmetries, centre, views[np.argmin(((3 - closeness) ** 2).mean(axis=1))])


def invariant_centre(model: ObjectModel) -> FloatArray:
    """(3,) mean of the box centre over all symmetries: a point that no symmetry moves, metres."""
    centre = model.box_corners().mean(axis=0)
    return se3.act(model.symmetries.transforms(), centre).mean(axis=0)


def allocentric(camera_from_object: FloatArray, centre: FloatArray) -> FloatArray:
    """Rotations (N, 3, 3) as seen by a camera turned straight at the object's centre.

    Two pictures of one pose at different places of the image then get the same rotation.
    """
    ray = se3.act(camera_from_object, centre[None])[:, 0]
    ray = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    return _to_axis(ray) @ camera_from_object[:, :3, :3]


def _to_axis(rays: FloatArray) -> FloatArray:
    """Least rotations (N, 3, 3) that turn unit rays (z > -1) onto the optical axis."""
    x, y, z = rays.T
    scale = 1 / (1 + z)
    rows = (1 - x * x * scale, -x * y * scale, -x, -x * y * scale, 1 - y * y * scale, -y, x, y, z)
    return np.stack(rows, axis=-1).reshape(-1, 3, 3)
