"""The femoral nail: cannulated, thick proximal part, locking holes at both ends, anterior bow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from datagen.instruments.shapes import Point, block, cut, drill, slot, turned


@dataclass(frozen=True)
class NailDimensions:
    """Femoral nail in the frame of the mounted set: proximal end face at z = 0, the nail points down z."""

    length: float = 0.340
    proximal_diameter: float = 0.0130
    proximal_length: float = 0.128
    shaft_diameter: float = 0.0105
    taper_length: float = 0.018
    tip_length: float = 0.022
    bore_diameter: float = 0.0046
    socket_diameter: float = 0.0080
    socket_depth: float = 0.022
    bow_radius: float = 1.2
    """Radius of the anterior bow, which starts where the proximal part ends."""
    flute_depth: float = 0.0010
    notch_depth: float = 0.0032
    notch_widths: tuple[float, float] = (0.0052, 0.0036)
    """Widths of the keying notches in the proximal face on +x and -x."""
    recon_heights: tuple[float, float] = (-0.040, -0.060)
    """z of the two oblique holes towards the femoral neck."""
    recon_diameter: float = 0.0062
    recon_angle: float = np.deg2rad(130.0)
    """Angle between the shaft (down) and the femoral neck."""
    locking_diameter: float = 0.0052
    static_height: float = -0.100
    dynamic_heights: tuple[float, float] = (-0.118, -0.112)
    """Ends of the oblong hole."""
    distal_heights: tuple[float, float, float] = (-0.285, -0.300, -0.315)
    """z of the distal holes: sideways, fore-and-aft, sideways."""


def neck_direction(d: NailDimensions) -> Point:
    """Unit direction of the oblique holes: from lateral below to medial above."""
    return (-float(np.sin(d.recon_angle)), 0.0, -float(np.cos(d.recon_angle)))


def nail(d: NailDimensions) -> Manifold:
    """Nail drawn straight, then bent by its bow."""
    proximal, shaft = d.proximal_diameter / 2, d.shaft_diameter / 2
    body = turned(
        [
            (0.0022, -d.length),
            (0.0034, -d.length + 0.0015),
            (shaft - 0.0006, -d.length + 0.6 * d.tip_length),
            (shaft, -d.length + d.tip_length),
            (shaft, -d.proximal_length - d.taper_length),
            (proximal, -d.proximal_length),
            (proximal, -0.0008),
            (proximal - 0.0008, 0.0),
        ],
        segments=32,
    )
    bore = drill(d.bore_diameter / 2, (0.0, 0.0, -d.length / 2), (0.0, 0.0, 1.0), d.length + 0.02, segments=16)
    socket = drill(d.socket_diameter / 2, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 2 * d.socket_depth, segments=24)
    straight = cut(body, [bore, socket, *_notches(d), *_locking_holes(d), *_flutes(d)])
    return straight.refine_to_length(0.016).warp_batch(lambda points: bowed(points, d))


def bowed(points: NDArray[np.float64], d: NailDimensions) -> NDArray[np.float64]:
    """Bends straight-nail points (N, 3) on a circle in the yz plane; sections stay square to the axis."""
    points = np.asarray(points)
    angle = np.maximum(-d.proximal_length - points[:, 2], 0.0) / d.bow_radius
    below = np.maximum(points[:, 2], -d.proximal_length)
    radius = d.bow_radius + points[:, 1]
    return np.column_stack([points[:, 0], radius * np.cos(angle) - d.bow_radius, below - radius * np.sin(angle)])


def _notches(d: NailDimensions) -> list[Manifold]:
    wide, narrow = d.notch_widths
    reach = d.proximal_diameter
    return [
        block((0.0, -wide / 2, -d.notch_depth), (reach, wide / 2, d.notch_depth), 1e-4),
        block((-reach, -narrow / 2, -d.notch_depth), (0.0, narrow / 2, d.notch_depth), 1e-4),
    ]


def _locking_holes(d: NailDimensions) -> list[Manifold]:
    across, forward = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    depth = 2 * d.proximal_diameter
    radius = d.locking_diameter / 2
    recon = [drill(d.recon_diameter / 2, (0.0, 0.0, z), neck_direction(d), depth, segments=24) for z in d.recon_heights]
    static = drill(radius, (0.0, 0.0, d.static_height), across, depth, segments=24)
    low, high = d.dynamic_heights
    dynamic = slot(radius, (0.0, 0.0, low), (0.0, 0.0, high), across, depth)
    distal = [
        drill(radius, (0.0, 0.0, z), direction, depth, segments=24)
        for z, direction in zip(d.distal_heights, (across, forward, across), strict=True)
    ]
    return [*recon, static, dynamic, *distal]


def _flutes(d: NailDimensions) -> list[Manifold]:
    """Two grooves along the rear of the shaft, where the nail relieves the marrow pressure."""
    radius = 0.0025
    distance = d.shaft_diameter / 2 - d.flute_depth + radius
    top = -d.proximal_length - d.taper_length - 0.004
    bottom = d.distal_heights[0] + 0.012
    angles = np.deg2rad([210.0, 330.0])
    return [slot_along_z(radius, distance * float(np.cos(a)), distance * float(np.sin(a)), bottom, top) for a in angles]


def slot_along_z(radius: float, x: float, y: float, low: float, high: float) -> Manifold:
    """Ball-ended groove cutter parallel to z."""
    return Manifold.batch_hull(
        [Manifold.sphere(radius, 16).translate((x, y, z)) for z in (low + radius, high - radius)]
    )
