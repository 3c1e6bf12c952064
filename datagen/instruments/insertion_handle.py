"""The insertion handle: a C-shaped arch from the nail connector to a grip leg that carries the aiming arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from datagen.instruments.nail import NailDimensions
from datagen.instruments.shapes import block, cut, drill, lofted, rod, rounded_rectangle, turned, union


@dataclass(frozen=True)
class HandleDimensions:
    """Handle in the frame of the mounted set: the connector meets the nail at z = 0."""

    connector_diameter: float = 0.0160
    key_clearance: float = 0.0001
    head_height: float = 0.116
    """z of the seat for the roller."""
    head_diameter: float = 0.026
    bore_diameter: float = 0.0090
    seat_diameter: float = 0.0120
    seat_depth: float = 0.0105
    spine: tuple[tuple[float, float], ...] = (
        (-0.006, 0.098),
        (0.022, 0.1035),
        (0.052, 0.106),
        (0.080, 0.092),
        (0.097, 0.062),
        (0.100, 0.020),
        (0.100, -0.030),
        (0.100, -0.075),
    )
    """Points (x, z) of the arch's middle line."""
    depths: tuple[float, float] = (0.018, 0.0185)
    """Size of the section in the plane of the arch at its start and end."""
    widths: tuple[float, float] = (0.019, 0.028)
    """Size of the section across that plane at its start and end."""
    mount_face: float = 0.110
    """x of the flat that the aiming arm rests on."""
    mount_top: float = 0.002
    mount_holes: tuple[float, float] = (-0.022, -0.060)
    """z of the holes for the arm's pegs."""
    mount_hole_diameter: float = 0.0080
    pad_centre: tuple[float, float] = (0.0985, 0.044)
    """(x, z) of the side pad whose pin carries the gear."""
    pad_height: float = 0.0175
    """y of the pad's face."""
    pin_diameter: float = 0.0098
    pin_length: float = 0.020


def insertion_handle(d: HandleDimensions, mate: NailDimensions) -> Manifold:
    """Keyed connector barrel, roller seat, arched body with a finger grip, gear pin and arm mount."""
    body = union([_arch(d), _barrel(d), _mount(d), _pad(d), *_keys(d, mate)])
    return cut(body, [*_bores(d), *_grip(d), *_lightening(d)]).refine_to_length(0.016)


def _arch(d: HandleDimensions) -> Manifold:
    spine = np.asarray(d.spine)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(spine, axis=0), axis=1))])
    curve = CubicSpline(along, spine)
    stations = np.linspace(0.0, along[-1], 33)
    # The chamfered ends are two extra rings, drawn in a little.
    rings = [_ring(d, curve, stations[0], 0.80)]
    rings += [_ring(d, curve, s, 1.0) for s in (stations[0] + 0.002, *stations[1:-1], stations[-1] - 0.002)]
    rings.append(_ring(d, curve, stations[-1], 0.85))
    return lofted(rings)


def _ring(d: HandleDimensions, curve: CubicSpline, station: float, scale: float) -> NDArray[np.float64]:
    share = station / curve.x[-1]
    depth = d.depths[0] + share * (d.depths[1] - d.depths[0])
    width = d.widths[0] + share * (d.widths[1] - d.widths[0])
    section = rounded_rectangle(scale * depth / 2, scale * width / 2, 0.0055)
    x, z = curve(station)
    tangent = curve(station, 1)
    tangent = tangent / np.linalg.norm(tangent)
    normal = np.array([-tangent[1], tangent[0]])
    # The tangent, the in-plane normal and y form a left-handed set in that order, hence the minus.
    return np.column_stack([x + section[:, 0] * normal[0], -section[:, 1], z + section[:, 0] * normal[1]])


def _barrel(d: HandleDimensions) -> Manifold:
    r, head = d.connector_diameter / 2, d.head_diameter / 2
    return turned(
        [
            (r - 0.0015, 0.0),
            (r, 0.0015),
            (r, 0.022),
            (r - 0.0012, 0.0232),
            (r - 0.0012, 0.0268),
            (r, 0.028),
            (r, 0.060),
            (r + 0.0015, 0.064),
            (r + 0.0015, 0.080),
            (head, 0.088),
            (head, d.head_height - 0.0015),
            (head - 0.0015, d.head_height),
        ]
    )


def _keys(d: HandleDimensions, mate: NailDimensions) -> list[Manifold]:
    gap = d.key_clearance
    wide, narrow = (w / 2 - gap for w in mate.notch_widths)
    depth = mate.notch_depth - gap
    outer = mate.proximal_diameter / 2 - 0.0010
    inner = mate.socket_diameter / 2 + 0.0006
    return [
        block((inner, -wide, -depth), (outer, wide, 0.004), 2e-4),
        block((-outer, -narrow, -depth), (-inner, narrow, 0.004), 2e-4),
    ]


def _mount(d: HandleDimensions) -> Manifold:
    half = d.widths[1] / 2
    end = d.spine[-1][1]
    return block((d.mount_face - 0.018, -half, end), (d.mount_face, half, d.mount_top), 0.0015)


def _pad(d: HandleDimensions) -> Manifold:
    x, z = d.pad_centre
    pad = rod(0.0095, 0.0, d.pad_height, 0.0010)
    pin = rod(d.pin_diameter / 2, 0.0, d.pad_height + d.pin_length, 0.0008)
    # A half turn about x and y takes z to y.
    return (pad + pin).rotate((-90.0, 0.0, 0.0)).translate((x, 0.0, z))


def _bores(d: HandleDimensions) -> list[Manifold]:
    up, across = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    return [
        drill(d.bore_diameter / 2, (0.0, 0.0, d.head_height / 2), up, d.head_height + 0.02),
        drill(d.seat_diameter / 2, (0.0, 0.0, d.head_height), up, 2 * d.seat_depth),
        *(drill(d.mount_hole_diameter / 2, (d.mount_face, 0.0, z), across, 0.05) for z in d.mount_holes),
    ]


def _grip(d: HandleDimensions) -> list[Manifold]:
    """Finger hollows on the side that faces the nail."""
    return [drill(0.0125, (0.0815, 0.0, z), (0.0, 1.0, 0.0), 0.06, segments=40) for z in (0.030, 0.008, -0.014, -0.036)]


def _lightening(d: HandleDimensions) -> list[Manifold]:
    """Shallow pocket in the arch, on the side away from the gear."""
    pocket = Manifold.batch_hull(
        [
            drill(0.0048, (x, -d.widths[0] / 2, z), (0.0, 1.0, 0.0), 0.008, segments=24)
            for x, z in ((0.026, 0.104), (0.056, 0.1045))
        ]
    )
    return [pocket]
