"""From views with object estimates to cameras and objects in common worlds, or a reason."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from multicam.bundle.scenery.scenery import Scenery
from multicam.dataset.objects import Catalogue
from multicam.matching.arrays import IntArray
from multicam.matching.learned import NoiseModel
from multicam.matching.linear import probability_within, total_std
from multicam.registration.answer import component_of
from multicam.registration.config import RegistrationConfig
from multicam.registration.group import Group
from multicam.registration.links import Link, links_between_views, links_to_map, witnessed
from multicam.registration.placement import seed, spread
from multicam.registration.refinement import Refinement, refine, seen_from, sharpen
from multicam.registration.refusal import CONTRADICTED, explain, explain_imprecise
from multicam.types import Component, Registration, View


def register_views(
    views: Sequence[View],
    catalogue: Catalogue,
    config: RegistrationConfig,
    noise: NoiseModel | None = None,
    scenery: Scenery | None = None,
) -> Registration:
    """Places the cameras of views, taken at one time, by the objects they see.

    Each component has the frame of its first camera (in the order of `views`) as its world, and its covariances are
    relative to that camera. A view whose pose is not probable or not precise enough is refused with a reason, and so is
    a view alone. The answer does not depend on the order of the views.

    Args:
        views: what each camera saw; keypoints of detections must be free of lens distortion.
        noise: what `learn_noise` found out about such estimates; without it they are taken at their word.
        scenery: points of each view's picture, by its name. What pictures share beside the objects confirms, sharpens
            or contradicts what the objects tell.

    Raises:
        DataError: an estimate of a class that the catalogue does not hold.
        ValueError: two views of one name.
    """
    group = Group.of(views, catalogue, config, noise, scenery)
    found, refusals = solve(group)
    components = tuple(_finish(group, refinement, views) for refinement in found)
    return Registration(components, {group.views[v].view_id: reason for v, reason in sorted(refusals.items())})


def solve(group: Group) -> tuple[list[Refinement], dict[int, str]]:
    """The refined components of a group, and the reason for each view that is in none."""
    group, between = witnessed(group, links_between_views(group))
    tried, refusals = list(between), dict[int, str]()
    unplaced = set(range(len(group.views)))
    components: list[Refinement] = []
    for link in sorted((k for k in between if k.doubt is None), key=lambda k: -k.log_odds):
        if not {link.reference, link.query} <= unplaced:
            continue
        found = _grow(group, link, between, unplaced, tried)
        found = _without_contradicted(group, found, refusals)
        found = _without_imprecise(group, found, refusals)
        placed = set(found.placement.views.tolist())
        if len(placed) == 1:
            refusals.update(dict.fromkeys(placed, "the other view that it fits is not known precisely enough"))
            continue
        unplaced -= placed
        components.append(found)
    return components, {view: refusals.get(view) or explain(group, view, tried) for view in unplaced}


def _grow(group: Group, link: Link, between: list[Link], unplaced: set[int], tried: list[Link]) -> Refinement:
    """A component from its first link: views over believed links, then views that fit the map of all objects."""
    placement = spread(seed(link), between, unplaced)
    attempted = set(placement.views.tolist())
    refinement = refine(group, placement)
    while rest := unplaced - attempted:
        to_map = links_to_map(group, refinement.tracks.fused, rest)
        tried += to_map
        placement = spread(refinement.placement, between + to_map, rest)
        if len(placement.views) == len(refinement.placement.views):
            break
        attempted |= set(placement.views.tolist())
        refinement = refine(group, placement)
    return refinement


def _without_contradicted(group: Group, found: Refinement, refusals: dict[int, str]) -> Refinement:
    """Drops cameras one by one with which fewer bearings agree than disagree; the reasons go to `refusals`."""
    while found.bearings:
        against = _against(found)
        # Of two alike the later one, for the first is the world.
        worst = len(against) - 1 - int(np.argmax(against[::-1]))
        if against[worst] <= 0:
            break
        view = int(found.placement.views[worst])
        refusals[view] = CONTRADICTED
        found = refine(group, found.placement.only(found.placement.views != view))
    return found


def _against(found: Refinement) -> IntArray:
    """(c,) how many more bearings of each camera disagree with its pose than agree."""
    against = np.zeros(len(found.placement.views), dtype=np.int64)
    for bearings in found.bearings:
        vote = 1 - 2 * bearings.agrees(found.placement.world_from_camera)
        np.add.at(against, bearings.first, vote)
        np.add.at(against, bearings.second, vote)
    return against


def _without_imprecise(group: Group, found: Refinement, refusals: dict[int, str]) -> Refinement:
    """Sharpens, and drops the least certain camera until all are certain enough; the reasons go to `refusals`."""
    limits = group.config.placement
    while True:
        found = sharpen(group, found)
        rotation, position = found.placement.covariance[:, :3, :3], found.placement.covariance[:, 3:, 3:]
        useless = 2 - (
            probability_within(rotation, np.radians(limits.max_rotation_error_deg))
            + probability_within(position, limits.max_position_error)
        )
        worst = int(np.argmax(useless))
        if 1 - useless[worst] >= limits.min_useful:
            return found
        view = int(found.placement.views[worst])
        refusals[view] = explain_imprecise(float(total_std(rotation)[worst]), float(total_std(position)[worst]))
        found = refine(group, found.placement.only(found.placement.views != view))


def _finish(group: Group, found: Refinement, views: Sequence[View]) -> Component:
    """The component as seen from the first of its cameras in the caller's order."""
    order = {view.view_id: n for n, view in enumerate(views)}
    given = np.array([order[group.views[v].view_id] for v in found.placement.views.tolist()])
    return component_of(group, seen_from(found, int(np.argmin(given))), np.argsort(given))
