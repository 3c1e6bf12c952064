"""Which true objects figures are about: by distance from the camera and by how much of them is seen."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from multicam.dataset.bop_reader import Instance
from multicam.errors import ConfigError, DataError

LEAST_VISIBLE = 0.1
"""Objects of which less than this fraction is seen are never asked for (BOP)."""


@dataclass(frozen=True)
class Selection:
    """Objects from `nearest` up to but not including `furthest` (metres), and likewise by visible fraction.

    Raises:
        ConfigError: an empty range, or objects that are never asked for.
    """

    nearest: float = 0.0
    furthest: float = float("inf")
    least_visible: float = LEAST_VISIBLE
    most_visible: float = float("inf")

    def __post_init__(self) -> None:
        if not 0 <= self.nearest < self.furthest:
            raise ConfigError(
                f"distances from {self.nearest:g} to {self.furthest:g} m hold nothing; give the smaller one first."
            )
        if not LEAST_VISIBLE <= self.least_visible <= 1:
            raise ConfigError(
                f"the least visible fraction is {self.least_visible:g}; it must be {LEAST_VISIBLE:g} to 1, for objects "
                "less visible are never asked for."
            )

    def takes(self, truth: Instance) -> bool:
        """Whether an object belongs; one whose visible fraction is unknown counts as visible."""
        near = self.nearest <= distance(truth) < self.furthest
        seen = truth.visible_fraction is None or self.least_visible <= truth.visible_fraction < self.most_visible
        return near and seen

    def words(self) -> str:
        """What is selected, as the end of a sentence."""
        seen = f"{100 * self.least_visible:.0f} % visible or more"
        everywhere = self.nearest == 0 and self.furthest == float("inf")
        return seen if everywhere else f"{self.nearest:g} to {self.furthest:g} m away, {seen}"

    def require_visibility(self, truths: Iterable[Instance]) -> None:
        """Refuses to choose by a visible fraction that is not known.

        Raises:
            DataError: more visibility is asked for than BOP's least, and some object states none.
        """
        if self.least_visible > LEAST_VISIBLE and any(truth.visible_fraction is None for truth in truths):
            raise DataError(
                f"the least visible fraction is {self.least_visible:g} but the split does not state how visible its "
                f"objects are: it lacks scene_gt_info.json; leave {LEAST_VISIBLE:g}."
            )


ASKED = Selection()
"""All objects that are visible enough to be asked for."""

DISTANCE_BINS = {
    "below 0.5 m": Selection(0.0, 0.5),
    "0.5 to 0.75 m": Selection(0.5, 0.75),
    "0.75 to 1 m": Selection(0.75, 1.0),
    "1 m and more": Selection(1.0),
}

VISIBILITY_BINS = {
    "10 to 25 %": Selection(least_visible=LEAST_VISIBLE, most_visible=0.25),
    "25 to 50 %": Selection(least_visible=0.25, most_visible=0.5),
    "50 to 75 %": Selection(least_visible=0.5, most_visible=0.75),
    "75 to 100 %": Selection(least_visible=0.75),
}


def distance(truth: Instance) -> float:
    """From the camera to the object's origin, metres."""
    return float(np.linalg.norm(truth.camera_from_object[:3, 3]))
