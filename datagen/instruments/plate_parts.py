"""The milled parts: bar (three half-turn symmetries), gear (sixfold) and spacer (none)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold

from datagen.instruments.shapes import along, block, cut, drill, rod, slab, slot, turned, union

UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class BarDimensions:
    """Connecting bar: length along x, thickness along z, symmetric about all three coordinate planes."""

    length: float = 0.170
    width: float = 0.020
    thickness: float = 0.007
    end_hole_diameter: float = 0.0054
    end_hole_inset: float = 0.010
    row_hole_diameter: float = 0.0082
    row_holes: tuple[float, float] = (0.056, 0.040)
    """Distances of the round holes from the middle."""
    slot_length: float = 0.050
    slot_width: float = 0.0075
    scallop_radius: float = 0.030
    scallop_depth: float = 0.0025


def bar(d: BarDimensions) -> Manifold:
    """Round-ended plate with a middle slot, rows of sunk holes and scalloped edges."""
    half, radius, face = d.length / 2, d.width / 2, d.thickness / 2
    plate = slab([(half - radius, 0.0, radius), (radius - half, 0.0, radius)], -face, face, 0.0010)
    holes = []
    for side in (-1.0, 1.0):
        end = side * (half - d.end_hole_inset)
        holes.append(drill(d.end_hole_diameter / 2, (end, 0.0, 0.0), UP, 0.02, 0.0006, face))
        for x in d.row_holes:
            centre = (side * x, 0.0, 0.0)
            holes.append(drill(d.row_hole_diameter / 2, centre, UP, 0.02, 0.0010, face))
        reach = radius + d.scallop_radius - d.scallop_depth
        holes.append(drill(d.scallop_radius, (0.0, side * reach, 0.0), UP, 0.02, segments=96))
    run = (d.slot_length - d.slot_width) / 2
    holes.append(slot(d.slot_width / 2, (-run, 0.0, 0.0), (run, 0.0, 0.0), UP, 0.02))
    return cut(plate, holes).refine_to_length(0.012)


@dataclass(frozen=True)
class GearDimensions:
    """Spur gear about z: the flat rear face at z = 0, a hub on the other side."""

    teeth: int = 18
    lightening_holes: int = 6
    tip_diameter: float = 0.048
    root_diameter: float = 0.0385
    width: float = 0.009
    hub_diameter: float = 0.020
    hub_height: float = 0.017
    bore_diameter: float = 0.0100
    web_recess: float = 0.0028
    hole_diameter: float = 0.0062
    hole_circle: float = 0.0285


def gear(d: GearDimensions) -> Manifold:
    """Toothed wheel with a recessed web, six lightening holes and a stepped hub."""
    root, tip = d.root_diameter / 2, d.tip_diameter / 2
    pitch = 2 * np.pi / d.teeth
    # One tooth as (share of the pitch, radius): straight flanks with a slight crown.
    tooth = [
        (-0.30, root),
        (-0.24, root + 0.0008),
        (-0.11, tip),
        (0.11, tip),
        (0.24, root + 0.0008),
        (0.30, root),
    ]
    outline = [
        (r * np.cos((i + share) * pitch), r * np.sin((i + share) * pitch)) for i in range(d.teeth) for share, r in tooth
    ]
    blank = Manifold.extrude(CrossSection([outline]), d.width) ^ rod(tip + 0.0002, 0.0, d.width, 0.0012, 72)
    hub = rod(d.hub_diameter / 2, 0.0, d.hub_height, 0.0010)
    ring = rod(root - 0.0035, d.width - d.web_recess, d.width + 0.001) - rod(d.hub_diameter / 2, 0.0, d.hub_height)
    angles = 2 * np.pi * np.arange(d.lightening_holes) / d.lightening_holes
    holes = [
        drill(
            d.hole_diameter / 2,
            (d.hole_circle / 2 * float(np.cos(a)), d.hole_circle / 2 * float(np.sin(a)), 0.0),
            UP,
            0.04,
            segments=24,
        )
        for a in angles
    ]
    bore = turned(
        [
            (d.bore_diameter / 2, -0.001),
            (d.bore_diameter / 2, d.hub_height - 0.001),
            (d.bore_diameter / 2 + 0.002, d.hub_height + 0.001),
        ]
    )
    return cut(cut(blank, [ring]) + hub, [*holes, bore]).refine_to_length(0.010)


@dataclass(frozen=True)
class SpacerDimensions:
    """Guide bracket: a sleeve about z standing on a flange whose face is at z = 0."""

    height: float = 0.032
    sleeve_diameter: float = 0.0165
    bore_diameter: float = 0.0083
    flange_thickness: float = 0.007
    flange_radius: float = 0.0120
    ear_centre: tuple[float, float] = (0.024, 0.009)
    ear_radius: float = 0.0075
    ear_height: float = 0.022
    ear_width: float = 0.0115
    ear_thickness: float = 0.0075
    ear_hole_diameter: float = 0.0052
    collar_diameter: float = 0.0195
    window_width: float = 0.0050


def spacer(d: SpacerDimensions) -> Manifold:
    """Sleeve with a collar and a side window, on a flange with a raised, cross-drilled ear."""
    ear_x, ear_y = d.ear_centre
    flange = slab([(0.0, 0.0, d.flange_radius), (ear_x, ear_y, d.ear_radius)], 0.0, d.flange_thickness, 0.0010)
    sleeve = rod(d.sleeve_diameter / 2, 0.0, d.height, 0.0008)
    collar = rod(d.collar_diameter / 2, d.height - 0.008, d.height - 0.003, 0.0008)
    rib_end = float(np.hypot(ear_x, ear_y))
    rib = block((0.0, -0.0022, 0.001), (rib_end, 0.0022, 0.45 * d.ear_height), 0.0008)
    rib = rib.rotate((0.0, 0.0, float(np.rad2deg(np.arctan2(ear_y, ear_x)))))
    middle = (d.flange_thickness + d.height - 0.008) / 2
    window = block((-0.02, -d.window_width / 2, middle - 0.0055), (0.0, d.window_width / 2, middle + 0.0055), 0.0012)
    tools = [
        drill(d.bore_diameter / 2, (0.0, 0.0, d.height / 2), UP, 0.08, 0.0008, d.height / 2),
        drill(d.ear_hole_diameter / 2, (ear_x, ear_y, _ear_axis(d)), (1.0, 0.0, 0.0), 0.02, segments=24),
        drill(0.0025, (0.004, -0.0100, 0.0), UP, 0.04, segments=24),
        window,
        # A flat on the collar stops the sleeve from turning.
        block((-0.02, 0.0074, d.height - 0.009), (0.02, 0.03, d.height + 0.01), 1e-4),
    ]
    return cut(union([flange, sleeve, collar, rib, _ear(d)]), tools).refine_to_length(0.008)


def _ear_axis(d: SpacerDimensions) -> float:
    """z of the cross hole: the centre of the ear's round top."""
    return d.ear_height - d.ear_width / 2


def _ear(d: SpacerDimensions) -> Manifold:
    """Upright lug with a round top about the cross hole."""
    x, y = d.ear_centre
    half, thick = d.ear_width / 2, d.ear_thickness / 2
    foot = block((x - thick, y - half, 0.001), (x + thick, y + half, d.flange_thickness), 0.0005)
    top = along(rod(half, -thick, thick, 0.0005), (x, y, _ear_axis(d)), (1.0, 0.0, 0.0))
    return Manifold.batch_hull([foot, top])
