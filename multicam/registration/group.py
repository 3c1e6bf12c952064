"""The input of one registration, prepared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multicam.bundle.scenery.scenery import Bearing, Scenery
from multicam.dataset.objects import Catalogue
from multicam.matching.keypoints import Keypoints, keypoints_of
from multicam.matching.learned import NoiseModel
from multicam.matching.observations import PosedObjects, observe
from multicam.matching.symmetry import SymmetryTable
from multicam.registration.config import RegistrationConfig
from multicam.types import View


@dataclass(frozen=True, eq=False)
class Group:
    """Views, their estimates as arrays, and how to treat them.

    Attributes:
        views: in ascending order of their names, so that the answer does not depend on the order given.
        estimates: of all views; their frame is the position of the view.
        kinship: see NoiseModel.
        scenery: what the pictures of the views, by their names, share beside the objects; None without pictures.
        bearings: those between views that it has shown.
    """

    views: tuple[View, ...]
    estimates: PosedObjects
    symmetries: SymmetryTable
    catalogue: Catalogue
    config: RegistrationConfig
    kinship: float
    scenery: Scenery | None = None
    bearings: tuple[Bearing, ...] = ()

    @classmethod
    def of(
        cls,
        views: Sequence[View],
        catalogue: Catalogue,
        config: RegistrationConfig,
        noise: NoiseModel | None,
        scenery: Scenery | None = None,
    ) -> Group:
        """Prepares views.

        Raises:
            DataError: an estimate of an unknown class.
            ValueError: two views of one name.
        """
        ordered = tuple(sorted(views, key=lambda view: view.view_id))
        if len({view.view_id for view in ordered}) < len(ordered):
            raise ValueError(f"each view needs a name of its own; got {[view.view_id for view in ordered]}")
        estimates = observe(ordered, catalogue, config.noise, noise)
        kinship = 1.0 if noise is None else noise.kinship
        return cls(ordered, estimates, SymmetryTable.of(catalogue), catalogue, config, kinship, scenery)

    def of_views(self, views: set[int]) -> PosedObjects:
        """The estimates of some views."""
        return self.estimates[np.isin(self.estimates.frame, list(views))]

    def source(self, estimate: int) -> tuple[View, int]:
        """The view of an estimate and its position there."""
        frame = int(self.estimates.frame[estimate])
        return self.views[frame], estimate - int(np.searchsorted(self.estimates.frame, frame))

    def keypoints(self, estimate: int) -> Keypoints | None:
        """What the detector saw of an estimate; see `keypoints_of`."""
        view, index = self.source(estimate)
        return keypoints_of(view.estimates[index], view.camera_matrix, self.catalogue)
