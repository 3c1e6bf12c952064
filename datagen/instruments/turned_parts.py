"""The lathe work: screw, stick and roller, each an exact solid of revolution about z."""

from __future__ import annotations

from dataclasses import dataclass

from manifold3d import Manifold

from datagen.instruments.shapes import cut, ridged, turned


@dataclass(frozen=True)
class ScrewDimensions:
    """Locking screw. The origin is the centre of the under-head face; the shaft points down z."""

    length: float = 0.060
    """Under-head face to tip."""
    diameter: float = 0.0050
    core_diameter: float = 0.0038
    ridges: int = 26
    """Annular ridges stand for the thread, so that the part is an exact solid of revolution."""
    plain_length: float = 0.0035
    tip_length: float = 0.0045
    head_diameter: float = 0.0090
    head_height: float = 0.0060
    socket_diameter: float = 0.0046
    socket_depth: float = 0.0034


def screw(d: ScrewDimensions) -> Manifold:
    """Screw with a thread of annular ridges and a round grooved head with a driver socket."""
    core, head = d.core_diameter / 2, d.head_diameter / 2
    thread = ridged(core, d.diameter / 2, -d.length + d.tip_length, -d.plain_length, d.ridges)
    body = turned(
        [
            (0.0004, -d.length),
            *thread,
            (d.diameter / 2, -d.plain_length + 0.0004),
            (d.diameter / 2, 0.0),
            (head - 0.0006, 0.0),
            (head, 0.0006),
            (head, 0.40 * d.head_height),
            (head - 0.0006, 0.50 * d.head_height),
            (head - 0.0002, 0.60 * d.head_height),
            (head - 0.0016, d.head_height),
        ],
        segments=24,
    )
    socket = turned(
        [
            (0.0002, d.head_height - d.socket_depth - 0.0008),
            (d.socket_diameter / 2, d.head_height - d.socket_depth),
            (d.socket_diameter / 2, d.head_height + 0.001),
        ],
        segments=24,
    )
    return body - socket


@dataclass(frozen=True)
class StickDimensions:
    """Guide rod. The tip is at the origin and the rod stands up z; shoulder and knob tell its ends apart."""

    length: float = 0.250
    diameter: float = 0.0080
    pilot_diameter: float = 0.0048
    pilot_length: float = 0.012
    knob_diameter: float = 0.0150
    knob_length: float = 0.024
    mark_spacing: float = 0.020
    mark_depth: float = 0.0005
    marks: int = 6


def stick(d: StickDimensions) -> Manifold:
    """Long round rod with a stepped pilot tip, depth marks and a grooved knob."""
    shaft, pilot, knob = d.diameter / 2, d.pilot_diameter / 2, d.knob_diameter / 2
    foot = d.length - d.knob_length
    profile = [(0.0004, 0.0), (pilot, 0.004), (pilot, d.pilot_length), (shaft - 0.0005, d.pilot_length)]
    profile.append((shaft, d.pilot_length + 0.0005))
    for i in range(1, d.marks + 1):
        z = d.pilot_length + i * d.mark_spacing
        half = 0.0008
        profile += [(shaft, z - half), (shaft - d.mark_depth, z - half + d.mark_depth)]
        profile += [(shaft - d.mark_depth, z + half - d.mark_depth), (shaft, z + half)]
    profile += [(shaft, foot), (knob - 0.0008, foot), (knob, foot + 0.0008)]
    profile += ridged(knob - 0.0010, knob, foot + 0.004, d.length - 0.005, 4, crest_share=0.35)
    profile += [(knob, d.length - 0.0045), (knob, d.length - 0.0020), (knob - 0.0020, d.length)]
    return turned(profile, segments=32).refine_to_length(0.012)


@dataclass(frozen=True)
class RollerDimensions:
    """Grooved impactor grip. The origin is the centre of the seat face, the spigot below, the body up z."""

    length: float = 0.082
    """Seat face to the top of the head, without the spigot."""
    spigot_diameter: float = 0.0118
    spigot_length: float = 0.010
    collar_diameter: float = 0.0200
    grip_diameter: float = 0.0260
    groove_depth: float = 0.0018
    grooves: int = 8
    head_diameter: float = 0.0320
    head_height: float = 0.013
    recess_diameter: float = 0.0120
    recess_depth: float = 0.006


def roller(d: RollerDimensions) -> Manifold:
    """Spigot, collar, grip with annular grooves, waist and a wide chamfered head with a recess."""
    spigot, collar = d.spigot_diameter / 2, d.collar_diameter / 2
    grip, head = d.grip_diameter / 2, d.head_diameter / 2
    head_foot = d.length - d.head_height
    profile = [
        (spigot - 0.001, -d.spigot_length),
        (spigot, -d.spigot_length + 0.001),
        (spigot, 0.0),
        (collar - 0.001, 0.0),
        (collar, 0.001),
        (collar, 0.006),
        (collar - 0.004, 0.009),
        (collar - 0.004, 0.012),
        (grip - 0.002, 0.013),
    ]
    profile += ridged(grip - d.groove_depth, grip, 0.014, head_foot - 0.009, d.grooves, crest_share=0.36)
    profile += [
        (grip - 0.0045, head_foot - 0.006),
        (grip - 0.0045, head_foot - 0.003),
        (head - 0.001, head_foot),
        (head, head_foot + 0.001),
        (head, d.length - 0.004),
        (head - 0.001, d.length - 0.002),
        (head - 0.004, d.length),
    ]
    recess = turned(
        [
            (d.recess_diameter / 2, d.length - d.recess_depth),
            (d.recess_diameter / 2, d.length - 0.001),
            (d.recess_diameter / 2 + 0.002, d.length + 0.001),
        ]
    )
    return cut(turned(profile), [recess])
