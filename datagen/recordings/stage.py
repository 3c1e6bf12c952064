"""A recording before it is rendered: a table with objects, a headset that wanders, two static cameras, events."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.recordings.board import PlacedBoard, place_board, solid_cloud
from datagen.recordings.clusters import Cluster, sample_clusters, sample_distractors
from datagen.recordings.config import SequenceConfig
from datagen.recordings.film import SetUp, film
from datagen.recordings.motions import CLEARANCE, Motion, sample_carry, sample_move
from datagen.recordings.statics import Unsuitable, in_image
from datagen.scenes.layout import Table
from datagen.scenes.looks import nominal_surface, plain_lamps, plain_surroundings
from datagen.scenes.places import plain_room
from datagen.scenes.spec import PlacedInstance, SceneSpec
from datagen.scenes.stock import Stock
from multicam.dataset.sequence import CameraEntry
from multicam.dataset.sequence_facts import SequenceTruth
from multicam.geometry import se3

BOARD_PICTURE = "board.png"
_SMALL = 0.13
"""Greatest radius of an object that is carried about, metres."""


@dataclass(frozen=True, eq=False)
class Stage:
    """A recording before it is rendered.

    Attributes:
        scene: its shots are those of the first camera of `cameras`, step by step, lost frames included, then those of
            the second, and so on.
        cameras: times and tracking as they will be written; the scene id is the place in this tuple, an image's
            number its step.
        rendered_as: per shot the first shot whose picture is the same but for the noise of the sensor.
        motions: of the objects that do not stay where they are.
        board: the ChArUco board, or None.
    """

    config: SequenceConfig
    scene: SceneSpec
    cameras: tuple[CameraEntry, ...]
    rendered_as: tuple[int, ...]
    motions: tuple[Motion, ...]
    board: PlacedBoard | None
    truth: SequenceTruth

    def shot_of(self, camera: CameraEntry, step: int) -> int:
        """Place of a camera's picture among the shots."""
        return camera.scene_id * self.config.steps + step


def draw_stage(config: SequenceConfig, stock: Stock, attempt: int) -> Stage:
    """One draw of a configuration's recording; same arguments, same draw.

    Raises:
        DataError: too few classes, or no group where one is asked for.
        Unsuitable: something has no room or no camera a place; another attempt may go better.
    """
    streams = np.random.SeedSequence((config.seed, attempt)).spawn(7)
    lay, look, stand, walk, move, clock, drift = (np.random.default_rng(s) for s in streams)
    table = Table()
    board = _sample_board(config, table, lay) if config.board else None
    clusters = sample_clusters(config, stock, table, lay)
    distractors, table = sample_distractors(config.distractors, clusters, table, lay)
    still = [cloud for cluster in clusters for cloud in cluster.clouds(stock)] + [solid_cloud(s) for s in distractors]
    motions = _sample_motions(config, stock, clusters, max(float(c[:, 2].max()) for c in still), table, move)
    things = [(obj_id, pose) for cluster in clusters for obj_id, pose in cluster.objects]
    for motion in motions:
        things[motion.index] = (things[motion.index][0], motion.at(0.0))
    objects = tuple(
        PlacedInstance(obj_id, pose, nominal_surface(stock.colors[obj_id], obj_id in stock.painted))
        for obj_id, pose in things
    )
    set_up = SetUp(config, stock, clusters, objects, motions, still, board)
    cameras, shots, truth = film(set_up, stand, walk, clock, drift)
    scene = SceneSpec(
        name=f"recording with seed {config.seed}",
        seed=int(look.integers(2**31)),
        objects=objects,
        solids=plain_room(look) + distractors + (board.solids if board else ()),
        lights=plain_lamps(),
        surroundings=plain_surroundings(look),
        shots=shots,
    )
    return Stage(config, scene, cameras, _same_pictures(scene, motions, stock, config), motions, board, truth)


def _sample_board(config: SequenceConfig, table: Table, rng: np.random.Generator) -> PlacedBoard:
    """Standing behind the clusters or between them, or, behind a single cluster, lying."""
    picture = config.output / BOARD_PICTURE
    turn = float(rng.normal(0, np.deg2rad(6)))
    lean = float(rng.uniform(15, 35))
    if config.layout == "apart":
        return place_board(picture, rng.uniform((-0.05, 0.15), (0.05, 0.4)), lean, turn, table, rng)
    if rng.uniform() < 0.5:
        return place_board(picture, rng.uniform((-0.1, 0.16), (0.1, 0.3)), lean, turn, table, rng)
    azimuth, away = rng.uniform(np.deg2rad(30), np.deg2rad(150)), config.radius + rng.uniform(0.12, 0.2)
    centre = away * np.array([np.cos(azimuth), np.sin(azimuth)])
    return place_board(picture, centre, None, turn, table, rng)


def _sample_motions(
    config: SequenceConfig,
    stock: Stock,
    clusters: tuple[Cluster, ...],
    top: float,
    table: Table,
    rng: np.random.Generator,
) -> tuple[Motion, ...]:
    """The object that is carried and the one that is put elsewhere, where configured; not the same one."""
    loose = [(side, i) for side, cluster in enumerate(clusters) for i in cluster.loose]
    firsts = np.cumsum([0] + [len(cluster.objects) for cluster in clusters])
    carried = moved = None
    if config.carry.reach_mm > 0:
        small = [(s, i) for s, i in loose if stock.bodies[clusters[s].objects[i][0]].radius < _SMALL]
        if not small:
            raise Unsuitable(f"No single object is smaller than {_SMALL:g} m in radius, so none can be carried.")
        carried = small[rng.integers(len(small))]
        loose.remove(carried)
    if config.move.at_s is not None:
        if not loose:
            raise Unsuitable("There is no single object left that could be moved.")
        moved = loose[rng.integers(len(loose))]
    motions: list[Motion] = []
    if moved is not None:
        side, local = moved
        obj_id, pose = clusters[side].objects[local]
        body = stock.bodies[obj_id]
        motions.append(sample_move(config.move, int(firsts[side]) + local, body, pose, top, table, rng))
        # What is carried has to pass above what is lifted.
        if carried is not None and carried[0] == side:
            top += float(se3.act(pose, body.points)[:, 2].max()) + CLEARANCE
    if carried is not None:
        side, local = carried
        body, centre = stock.bodies[clusters[side].objects[local][0]], clusters[side].centre
        motions.append(sample_carry(config.carry, int(firsts[side]) + local, body, centre, top, config.duration, rng))
    return tuple(motions)


def _same_pictures(
    scene: SceneSpec, motions: tuple[Motion, ...], stock: Stock, config: SequenceConfig
) -> tuple[int, ...]:
    """Shots of one camera in a row are alike if neither it nor anything in its picture has moved between them.

    What moves out of the picture may still change a shadow or a reflection in it by a trace; that is left out.
    """
    margin = 0.02 * config.width

    def in_sight(shot: int) -> list[NDArray[np.float64]]:
        taken, placed = scene.shots[shot], scene.objects_in(shot)
        things = [placed[m.index] for m in motions]
        clouds = [se3.act(item.world_from_object, stock.bodies[item.obj_id].points) for item in things]
        seen = [in_image(taken.camera, taken.world_from_camera, cloud, margin).any() for cloud in clouds]
        poses = [item.world_from_object * known for item, known in zip(things, seen, strict=True)]
        return [taken.world_from_camera, *poses]

    same: list[int] = []
    before: list[NDArray[np.float64]] = []
    for shot in range(len(scene.shots)):
        now = in_sight(shot)
        begins = shot % config.steps == 0 or not all(map(np.array_equal, before, now))
        same.append(shot if begins else same[-1])
        before = now
    return tuple(same)
