"""Single-view estimates as a user gives them: read, and refused where they belong to other objects or another unit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.dataset.results import Estimates, read_results
from multicam.errors import DataError

NEAREST = 0.1
"""Objects are seen from further than this share of their diameter; a thousandth of their distance is less."""


def read_candidates(path: Path, catalogue: Catalogue) -> Estimates:
    """Reads a BOP results file about objects of a data set.

    Raises:
        DataError: the file is missing, malformed, in metres, or holds a class that the data set does not know.
    """
    estimates = read_results(path)
    for (scene_id, im_id), found in estimates.items():
        unknown = sorted({estimate.obj_id for estimate in found if estimate.obj_id not in catalogue})
        if unknown:
            known = ", ".join(map(str, catalogue.obj_ids))
            raise DataError(
                f"{path} holds an estimate of class {unknown[0]} (scene {scene_id}, image {im_id}), which "
                f"models_info.json does not name; it names {known}."
            )
    distances = [
        float(np.linalg.norm(estimate.camera_from_object[:3, 3])) / catalogue[estimate.obj_id].diameter
        for found in estimates.values()
        for estimate in found
    ]
    if distances and float(np.median(distances)) < NEAREST:
        raise DataError(
            f"{path}: half of the objects are nearer to their camera than {np.median(distances):.2g} of their own "
            "diameter; translations must be in millimetres (BOP format), are they in metres?"
        )
    return estimates
