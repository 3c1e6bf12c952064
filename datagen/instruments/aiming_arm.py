"""The aiming arm: hangs on the handle, parallel to the nail, with guide holes that meet the nail's holes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from datagen.instruments.insertion_handle import HandleDimensions
from datagen.instruments.nail import NailDimensions, neck_direction
from datagen.instruments.shapes import block, cut, drill, lofted, ridged, rounded_rectangle, turned, union


@dataclass(frozen=True)
class ArmDimensions:
    """Arm in the frame of the mounted set: it rests on the handle's mount face and hangs down z."""

    top: float = -0.001
    length: float = 0.235
    thickness: float = 0.018
    relief: float = 0.003
    """How far the inner face stands back below the mount."""
    widths: tuple[float, float] = (0.032, 0.020)
    """Size along y at the mount and at the foot."""
    guide_diameter: float = 0.0082
    guide_length: float = 0.030
    spare_heights: tuple[float, ...] = (-0.196, -0.214)
    """z of further sideways guide holes."""
    peg_diameter: float = 0.0078
    peg_length: float = 0.007
    knob_diameter: float = 0.026
    knob_height: float = 0.016
    wing_reach: float = 0.020
    """How far the forward wing stands out beyond the arm's middle plane, along y."""


def aiming_arm(d: ArmDimensions, mount: HandleDimensions, mate: NailDimensions) -> Manifold:
    """Tapered beam with pegs, a locking knob, a forward wing and straight and oblique guide holes."""
    body = union([_beam(d, mount), *_pegs(d, mount), _knob(d, mount), _wing(d, mount), _foot(d, mount)])
    return cut(body, _holes(d, mount, mate)).refine_to_length(0.016)


def outer_face(d: ArmDimensions, mount: HandleDimensions) -> float:
    """x of the flat outer face, where sleeves and spacers rest."""
    return mount.mount_face + d.thickness


def _beam(d: ArmDimensions, mount: HandleDimensions) -> Manifold:
    inner, outer = mount.mount_face, outer_face(d, mount)
    bottom = d.top - d.length
    mount_end = mount.spine[-1][1] - 0.004
    wide, slim = (w / 2 for w in d.widths)
    step = 0.0015
    stations = [
        (bottom, inner + d.relief + step, outer - step, slim - step),
        (bottom + step, inner + d.relief, outer, slim),
        (mount_end - 0.012, inner + d.relief, outer, slim + 0.35 * (wide - slim)),
        (mount_end, inner, outer, wide),
        (d.top - step, inner, outer, wide),
        (d.top, inner + step, outer - step, wide - step),
    ]
    return lofted([_ring(*station) for station in stations])


def _ring(z: float, inner: float, outer: float, half_width: float) -> NDArray[np.float64]:
    section = rounded_rectangle((outer - inner) / 2, half_width, 0.0030)
    return np.column_stack([(inner + outer) / 2 + section[:, 0], section[:, 1], np.full(len(section), z)])


def _pegs(d: ArmDimensions, mount: HandleDimensions) -> list[Manifold]:
    radius = d.peg_diameter / 2
    return [
        turned([(radius, -0.004), (radius, d.peg_length - 0.001), (radius - 0.001, d.peg_length)], 32)
        .rotate((0.0, -90.0, 0.0))
        .translate((mount.mount_face, 0.0, z))
        for z in mount.mount_holes
    ]


def _knob(d: ArmDimensions, mount: HandleDimensions) -> Manifold:
    r, h = d.knob_diameter / 2, d.knob_height
    profile = [(r - 0.004, -0.004), (r - 0.004, 0.003), (r - 0.001, 0.004)]
    profile += ridged(r - 0.0012, r, 0.0045, h - 0.002, 5, crest_share=0.35)
    profile += [(r - 0.0015, h - 0.001), (r - 0.003, h)]
    knob = cut(turned(profile, 40), [turned([(0.004, h - 0.004), (0.004, h + 0.001)], 24)])
    z = sum(mount.mount_holes) / 2
    return knob.rotate((0.0, 90.0, 0.0)).translate((outer_face(d, mount), 0.0, z))


def _wing(d: ArmDimensions, mount: HandleDimensions) -> Manifold:
    inner, outer = mount.mount_face, outer_face(d, mount)
    top = mount.spine[-1][1] - 0.006
    return block((inner + 0.005, 0.0, top - 0.040), (outer - 0.003, d.wing_reach, top), 0.0020)


def _foot(d: ArmDimensions, mount: HandleDimensions) -> Manifold:
    """A stop on the inner side at the lower end, which rests on the thigh."""
    inner = mount.mount_face + d.relief
    bottom = d.top - d.length
    return block((inner - 0.012, -d.widths[1] / 2, bottom), (inner + 0.006, d.widths[1] / 2, bottom + 0.012), 0.0020)


def _holes(d: ArmDimensions, mount: HandleDimensions, mate: NailDimensions) -> list[Manifold]:
    middle = outer_face(d, mount) - (d.thickness - d.relief) / 2
    half = (d.thickness - d.relief) / 2
    radius = d.guide_diameter / 2
    straight = [
        drill(radius, (middle, 0.0, z), (1.0, 0.0, 0.0), 0.04, 0.0008, half)
        for z in (mate.static_height, mate.dynamic_heights[0], *d.spare_heights)
    ]
    direction = neck_direction(mate)
    oblique = [
        drill(radius, (middle, 0.0, z + middle / direction[0] * direction[2]), direction, 0.05)
        for z in mate.recon_heights
    ]
    wing_top = mount.spine[-1][1] - 0.006
    wing_holes = [
        drill(0.0031, (middle, d.wing_reach - 0.0055, wing_top - drop), (1.0, 0.0, 0.0), 0.04, segments=24)
        for drop in (0.008, 0.020, 0.032)
    ]
    return [*straight, *oblique, *wing_holes]
