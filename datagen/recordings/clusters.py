"""What lies on the table of a recording: one or two clusters of objects, and distractors about them."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from datagen.recordings.board import solid_cloud
from datagen.recordings.config import SequenceConfig
from datagen.recordings.motions import is_on_table
from datagen.recordings.statics import Unsuitable
from datagen.scenes.clutter import sample_distractor
from datagen.scenes.layout import Table, place
from datagen.scenes.spec import Solid
from datagen.scenes.stock import Group, Stock
from multicam.errors import DataError
from multicam.geometry import se3
from multicam.types import FloatArray

_LARGEST_GROUP = 5
"""Parts of a mounted group that leaves enough classes for the other cluster."""
_DISTRACTOR_REACH = 0.35
"""Metres around the middle of a cluster in which distractors lie."""
_TRIES = 30


@dataclass(frozen=True, eq=False)
class Cluster:
    """Objects that lie together.

    Attributes:
        centre: (2,) x and y, metres.
        objects: (obj_id, world_from_object) of each.
        loose: (n,) indices into `objects` of those that are not mounted on others.
    """

    centre: FloatArray
    objects: tuple[tuple[int, FloatArray], ...]
    loose: tuple[int, ...]

    def clouds(self, stock: Stock) -> list[FloatArray]:
        """(n, 3) surface points of each object, world."""
        return [se3.act(pose, stock.bodies[obj_id].points) for obj_id, pose in self.objects]


def sample_clusters(
    config: SequenceConfig, stock: Stock, table: Table, rng: np.random.Generator
) -> tuple[Cluster, ...]:
    """A left and a right cluster, or a single one; no class is in two of them, so a class names its cluster.

    Raises:
        DataError: too few classes, or no group where one is asked for.
        Unsuitable: the table is too full.
    """
    if len(stock.catalogue.obj_ids) < 2:
        raise DataError("A recording needs at least two object classes, one for each of its clusters.")
    apart = config.layout == "apart"
    centres = np.array([[-0.5, 0.0], [0.5, 0.0]]) * config.spacing if apart else np.zeros((1, 2))
    mounted: list[tuple[int, FloatArray]] = []
    if config.assembled:
        group = _draw_group(stock, rng)
        pose = place(table, group.body, centres[0], 0.02, rng)
        if not is_on_table(group.body, pose):
            raise Unsuitable("There is no room on the table for the mounted group.")
        mounted = [(obj_id, pose @ group_from_object) for obj_id, group_from_object in group.parts]
    classes = {obj_id for obj_id, _ in mounted}
    rest = [int(i) for i in rng.permutation([i for i in stock.catalogue.obj_ids if i not in classes])]
    half = max(0, (len(rest) + len(mounted)) // 2 - len(mounted)) if apart else len(rest)
    clusters: list[Cluster] = []
    for centre, own, before in zip(centres, (rest[:half], rest[half:]), (mounted, []), strict=False):
        # Long parts first: a spread needs their places while there is room.
        longest_first = sorted(own, key=lambda i: -stock.bodies[i].radius)
        objects = list(before)
        for obj_id in longest_first:
            pose = place(table, stock.bodies[obj_id], centre, config.radius, rng)
            if not is_on_table(stock.bodies[obj_id], pose):
                raise Unsuitable("There is no room on the table for all objects; raise radius or spacing.")
            objects.append((obj_id, pose))
        clusters.append(Cluster(centre, tuple(objects), tuple(range(len(before), len(objects)))))
    return tuple(clusters)


def sample_distractors(
    count: int, clusters: tuple[Cluster, ...], table: Table, rng: np.random.Generator
) -> tuple[tuple[Solid, ...], Table]:
    """Things that lie on the bare table about the clusters, as many as there is room for; and the table with them."""
    found: list[Solid] = []
    for _ in range(_TRIES * count):
        if len(found) == count:
            break
        trial = copy.deepcopy(table)
        solid = sample_distractor(trial, clusters[len(found) % len(clusters)].centre, _DISTRACTOR_REACH, rng)
        # One that would hang in the air or lie on an object is drawn again.
        if solid_cloud(solid)[:, 2].min() < 1e-6:
            table = trial
            found.append(solid)
    return tuple(found), table


def _draw_group(stock: Stock, rng: np.random.Generator) -> Group:
    small = [group for group in stock.groups if len(group.parts) <= _LARGEST_GROUP]
    if not small:
        raise DataError(
            f"assembled is true, but the models folder has no group of at most {_LARGEST_GROUP} parts in its "
            "assemblies.json; set assembled to false."
        )
    return small[rng.integers(len(small))]
