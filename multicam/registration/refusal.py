"""Why a view is not placed, in plain words, and what would help."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from multicam.registration.group import Group
from multicam.registration.links import Doubt, Link

CONTRADICTED = (
    "where its objects put it contradicts what pictures show beside them; did they move? Add some that stand still"
)


def explain(group: Group, view: int, links: Iterable[Link]) -> str:
    """One sentence for a view that no believed link reaches.

    Args:
        links: all that were tried; those of other views are ignored.
    """
    own = set(group.of_views({view}).obj_id.tolist())
    if not own:
        return "no known object was found in it; point it at objects that other views see"
    others = set(range(len(group.views))) - {view}
    common = own & set(group.of_views(others).obj_id.tolist())
    if not common:
        return f"it sees {_names(group, own)}, which no other view sees; let it share two objects with one of them"
    mine = [link for link in links if view in (link.reference, link.query)]
    doubts = {link.doubt for link in mine}
    shared = f"the objects it shares with others ({_names(group, common)})"
    if Doubt.LOOSE in doubts:
        return f"{shared} are symmetric about one axis and leave a turn about it open; add one without that symmetry"
    if Doubt.SCENERY in doubts:
        return f"{shared} contradict what the pictures show beside them; did they move? Add some that stand still"
    if Doubt.RIVAL in doubts:
        return f"{shared} fit two different poses about equally well; another shared object would decide"
    if None in doubts:
        return f"it fits one other view, but not the objects that the placed views agree on ({_names(group, common)})"
    if max(link.support for link in mine) < 2:
        return f"{shared} confirm no pose: a single one fits at a time, and two must agree; did they move?"
    return f"{shared} agree too loosely on a pose to rule out chance; another shared object would help"


def explain_imprecise(rotation_std: float, position_std: float) -> str:
    """One sentence for a view whose pose is right but too uncertain."""
    return (
        f"its pose is known to {np.degrees(rotation_std):.1f} degrees and {1000 * position_std:.0f} mm only "
        "(one standard deviation); objects that are larger, nearer or further apart would help"
    )


def _names(group: Group, obj_ids: set[int]) -> str:
    return ", ".join(group.catalogue[obj_id].name for obj_id in sorted(obj_ids))
