"""What the cameras of a recording see, and what they must see for it to keep its promises."""

from __future__ import annotations

from dataclasses import dataclass

from datagen.recordings.film import HEADSET, LEFT, RIGHT
from datagen.recordings.stage import Stage
from datagen.recordings.statics import BOARD_CORNERS, Unsuitable

_WELL_SEEN = 0.3
"""Visible fraction from which an object counts as shared."""
_SHARED = 2
"""Objects that two cameras must share."""
_MOST = 0.8
"""Share of the steps in which static cameras that overlap must share objects."""
_OFTEN = 0.5
"""Share of the steps in which the headset must share objects with them, or a carried object be well seen."""


@dataclass(frozen=True)
class View:
    """What one picture shows.

    Attributes:
        objects: index in the scene to visible fraction, of the objects in sight.
        corners: how many inner corners of the board it shows.
    """

    objects: dict[int, float]
    corners: int = 0

    @property
    def well_seen(self) -> set[int]:
        """The objects that are not mostly hidden."""
        return {index for index, fraction in self.objects.items() if fraction > _WELL_SEEN}


Sight = dict[str, dict[int, View]]
"""Camera to step to what it sees then; steps whose frame was lost are left out."""


def verify_sight(sight: Sight, stage: Stage, corners: int = BOARD_CORNERS) -> None:
    """Holds what the cameras see against what the recording promises.

    Static cameras that lie apart never share an object, and the headset shares some with each, at some times and not
    at all times; those that overlap nearly always share some. Every camera sees the board at some time. What is
    bumped, moved or carried can be seen to be.

    Args:
        corners: of the board that every camera must see.

    Raises:
        Unsuitable: the first promise that is broken.
    """
    if stage.config.layout == "apart":
        _verify_apart(sight, stage)
    else:
        _verify_overlap(sight, stage)
    _verify_board(sight, stage, corners)
    _verify_events(sight, stage)


def _verify_apart(sight: Sight, stage: Stage) -> None:
    name = stage.scene.name
    for step in sorted(sight[LEFT].keys() & sight[RIGHT].keys()):
        common = sorted(sight[LEFT][step].objects.keys() & sight[RIGHT][step].objects.keys())
        if common:
            classes = ", ".join(str(stage.scene.objects[index].obj_id) for index in common)
            raise Unsuitable(
                f"{name}: the static cameras both see objects of class {classes} at step {step}; "
                "raise spacing or focal, or take another seed."
            )
    for static in (LEFT, RIGHT):
        shared = _shared(sight, HEADSET, static)
        if max(shared) < _SHARED:
            raise Unsuitable(
                f"{name}: the headset shares at most {max(shared)} objects with camera {static} at any time, "
                f"{_SHARED} are needed; raise distance, lower focal, or take another seed."
            )
        if min(shared) >= _SHARED:
            raise Unsuitable(
                f"{name}: the headset shares objects with camera {static} all the time; raise spacing or focal."
            )


def _verify_overlap(sight: Sight, stage: Stage) -> None:
    for a, b in ((LEFT, RIGHT), (HEADSET, LEFT), (HEADSET, RIGHT)):
        shared = _shared(sight, a, b)
        enough = sum(count >= _SHARED for count in shared)
        if enough < (_MOST if HEADSET not in (a, b) else _OFTEN) * len(shared):
            raise Unsuitable(
                f"{stage.scene.name}: cameras {a} and {b} share {_SHARED} objects or more at only {enough} of "
                f"{len(shared)} steps; raise distance, lower focal or radius, or take another seed."
            )


def _verify_board(sight: Sight, stage: Stage, corners: int) -> None:
    if stage.board is None:
        return
    for camera, views in sight.items():
        most = max(view.corners for view in views.values())
        if most < corners:
            raise Unsuitable(
                f"{stage.scene.name}: camera {camera} sees at most {most} corners of the board at any time, "
                f"{corners} are needed; raise width, lower focal or distance, or take another seed."
            )


def _verify_events(sight: Sight, stage: Stage) -> None:
    name = stage.scene.name
    for event in stage.truth.bumps:
        before, after = _around(sight, stage, event.camera_id, event.timestamp_ns, event.timestamp_ns)
        if not (any(len(v.well_seen) >= _SHARED for v in before) and any(len(v.well_seen) >= _SHARED for v in after)):
            raise Unsuitable(
                f"{name}: the bumped camera {event.camera_id} does not see {_SHARED} objects before and after it; "
                "lower bump.shift_mm or bump.turn_deg, or change bump.at_s."
            )
    for motion, event in zip(stage.motions, stage.truth.motions, strict=True):
        if event.end_ns < _seconds_to_ns(stage.config.duration):
            halves = [_around(sight, stage, camera, event.start_ns, event.end_ns) for camera in (LEFT, RIGHT)]
            if not any(all(any(motion.index in v.well_seen for v in half) for half in pair) for pair in halves):
                raise Unsuitable(
                    f"{name}: no static camera sees the object that is moved (class {event.obj_id}) well both before "
                    "and after it; change move.at_s or move.distance, or take another seed."
                )
            continue
        seen = [sum(motion.index in v.well_seen for v in sight[c].values()) / len(sight[c]) for c in (LEFT, RIGHT)]
        if max(seen) < _OFTEN:
            raise Unsuitable(
                f"{name}: the object that is carried (class {event.obj_id}) is well seen by a static camera at only "
                f"{max(seen):.0%} of its steps; lower carry.reach_mm, raise distance, or take another seed."
            )


def _around(sight: Sight, stage: Stage, camera_id: str, start_ns: int, end_ns: int) -> tuple[list[View], list[View]]:
    """What a camera sees before the first and from the second of two true times on."""
    camera = next(c for c in stage.cameras if c.camera_id == camera_id)
    offset = stage.truth.clock_offsets_ns[camera_id]
    times = {entry.im_id: entry.timestamp_ns - offset for entry in camera.frames}
    views = sight[camera_id]
    before = [view for step, view in views.items() if times[step] < start_ns]
    return before, [view for step, view in views.items() if times[step] >= end_ns]


def _shared(sight: Sight, a: str, b: str) -> list[int]:
    """How many objects two cameras both see well, at each step for which both have a picture."""
    steps = sorted(sight[a].keys() & sight[b].keys())
    return [len(sight[a][step].well_seen & sight[b][step].well_seen) for step in steps] or [0]


def _seconds_to_ns(seconds: float) -> int:
    return round(seconds * 1e9)
