"""One object from five sides: dimensions, a bar of known length, numbered keypoints, axes of symmetry."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datagen.cad.turns import Turn, turns_of
from datagen.sheets.shade import Shaded, View
from datagen.sheets.svg import Drawing
from multicam.dataset.objects import ObjectModel
from multicam.geometry import so3
from multicam.geometry.mesh import Mesh
from multicam.types import FloatArray

WIDTH, HEIGHT = 372, 310
"""Pixels of a view."""
_BESIDE, _BELOW = 48, 38
"""Left free on each side, and above and below, for dimensions and labels; pixels."""
_AXIS_COLORS = {"x": "#d1242f", "y": "#1a7f37", "z": "#0969da"}
_SYMMETRY = "#8250df"
_INK, _SOFT = "#1d2430", "#5d6675"
_BARS_MM = (1, 10, 50, 100, 500, 1000)
_AXES_DRAWN = 4

_FLAT = {
    "from the front (-y)": ("x", "z", np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])),
    "from the right (+x)": ("y", "z", np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]])),
    "from above (+z)": ("x", "y", np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])),
}
"""Letters of the axes that point right and up, and view_from_object."""


def object_views(model: ObjectModel, mesh: Mesh) -> list[str]:
    """SVG markup of three flat views with dimensions and two oblique ones with keypoints and axes; all in one scale."""
    low, high = mesh.box
    middle, size = (low + high) / 2, high - low
    oblique = [_oblique(35, 28), _oblique(215, -28)]
    rotations = [rotation for _, _, rotation in _FLAT.values()] + oblique
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    spans = np.array([np.ptp((corners - middle) @ r[:2].T, axis=0) for r in rotations])
    scale = float(min((WIDTH - 2 * _BESIDE) / spans[:, 0].max(), (HEIGHT - 2 * _BELOW) / spans[:, 1].max()))
    shaded = Shaded(mesh)
    views = [View(rotation, middle, scale, WIDTH, HEIGHT) for rotation in rotations]
    turns = turns_of(model.symmetries)
    drawn = [
        _flat_view(shaded, view, name, right, up, size)
        for view, (name, (right, up, _)) in zip(views, _FLAT.items(), strict=False)
    ]
    for view, name in zip(views[3:], ("from the front right, above", "from the back left, below"), strict=True):
        drawn.append(_oblique_view(shaded, view, name, model, turns, mesh.box))
    return drawn


def _oblique(azimuth: float, elevation: float) -> FloatArray:
    """View from an azimuth (degrees from -y towards +x) and a height above the x-y plane."""
    upright = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return so3.exp(np.array([np.deg2rad(elevation), 0, 0])) @ upright @ so3.exp(np.array([0, 0, -np.deg2rad(azimuth)]))


def _start(shaded: Shaded, view: View, name: str, colored: bool) -> tuple[Drawing, FloatArray]:
    drawing = Drawing(WIDTH, HEIGHT, name)
    picture, depth = shaded.draw(view, colored)
    drawing.picture(picture, WIDTH, HEIGHT)
    drawing.text(np.array([8, 16]), name, 11, _SOFT)
    bar = max((mm for mm in _BARS_MM if mm * 1e-3 * view.scale < WIDTH / 3), default=_BARS_MM[0])
    end = np.array([WIDTH - 10.0, HEIGHT - 10.0])
    start = end - [bar * 1e-3 * view.scale, 0]
    drawing.line(start, end, _INK, 3)
    drawing.text(end - [0, 7], f"{bar} mm", 11, _INK, "end", bold=True)
    return drawing, depth


def _flat_view(shaded: Shaded, view: View, name: str, right: str, up: str, size: FloatArray) -> str:
    drawing, _ = _start(shaded, view, name, colored=False)
    centre = np.array([WIDTH - 1, HEIGHT - 1]) / 2
    half = np.array([size["xyz".index(right)], size["xyz".index(up)]]) * view.scale / 2
    below, beside = centre[1] + half[1] + 16, centre[0] - half[0] - 16
    color = _AXIS_COLORS[right]
    for x in (centre[0] - half[0], centre[0] + half[0]):
        drawing.line(np.array([x, centre[1] + half[1] + 3]), np.array([x, below + 5]), color, 0.7)
    drawing.arrow(np.array([centre[0] - half[0], below]), np.array([centre[0] + half[0], below]), color, 1.1, both=True)
    words = f"{right} {1000 * size['xyz'.index(right)]:.1f} mm"
    drawing.text(np.array([centre[0], below + 15]), words, 12, color, "middle", bold=True)
    color = _AXIS_COLORS[up]
    for y in (centre[1] - half[1], centre[1] + half[1]):
        drawing.line(np.array([centre[0] - half[0] - 3, y]), np.array([beside - 5, y]), color, 0.7)
    drawing.arrow(
        np.array([beside, centre[1] + half[1]]), np.array([beside, centre[1] - half[1]]), color, 1.1, both=True
    )
    words = f"{up} {1000 * size['xyz'.index(up)]:.1f} mm"
    drawing.text(np.array([beside - 8, centre[1]]), words, 12, color, "middle", bold=True, turned=True)
    return drawing.markup()


def _oblique_view(
    shaded: Shaded, view: View, name: str, model: ObjectModel, turns: Sequence[Turn], box: FloatArray
) -> str:
    drawing, depth = _start(shaded, view, name, shaded.has_colors)
    for turn in turns[:_AXES_DRAWN]:
        reach = 0.5 * float(np.linalg.norm(box[1] - box[0])) * 1.02
        # The stretch of the axis beside the object, wherever its own point lies.
        foot = turn.offset + turn.direction * (turn.direction @ (box.mean(0) - turn.offset))
        ends = view.project(np.stack((foot - reach * turn.direction, foot + reach * turn.direction)))
        drawing.line(ends[0], ends[1], "white", 3.2)
        drawing.line(ends[0], ends[1], _SYMMETRY, 1.6, dash="" if turn.fold == 0 else "6 4")
        label = "any angle" if turn.fold == 0 else f"{360 / turn.fold:.4g}°"
        top = ends[1] if ends[1][1] <= ends[0][1] else ends[0]
        drawing.text(
            np.clip(np.add(top, (5, -3)), [20, 26], [WIDTH - 60, HEIGHT - 24]), label, 11, _SYMMETRY, bold=True
        )
    _draw_keypoints(drawing, view, depth, model)
    corner = np.array([40.0, HEIGHT - 34.0])
    for letter, direction in zip("xyz", view.rotation[:2].T, strict=True):
        drawing.arrow(corner, corner + 22 * direction, _AXIS_COLORS[letter], 1.4)
        place = corner + 22 * direction + 8 * direction / max(float(np.linalg.norm(direction)), 0.3) + [0, 4]
        drawing.text(place, letter, 11, _AXIS_COLORS[letter], "middle", bold=True)
    return drawing.markup()


def _draw_keypoints(drawing: Drawing, view: View, depth: FloatArray, model: ObjectModel) -> None:
    """Filled where seen, hollow where the object itself hides them."""
    if model.keypoints is None:
        return
    pixels, behind = view.project(model.keypoints), view.depth(model.keypoints)
    columns = np.clip(np.rint(pixels[:, 0]).astype(int), 1, WIDTH - 2)
    rows = np.clip(np.rint(pixels[:, 1]).astype(int), 1, HEIGHT - 2)
    around = [depth[rows + dy, columns + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    hidden = behind > np.max(around, axis=0) + 0.01 * model.diameter
    for number, (pixel, covered) in enumerate(zip(pixels, hidden, strict=True)):
        drawing.dot(pixel, 3.4, "none" if covered else "#ffd33d", "#8a6100" if covered else _INK)
        drawing.text(np.add(pixel, (5, -4)), str(number), 11, "#8a6100" if covered else _INK, bold=not covered)
