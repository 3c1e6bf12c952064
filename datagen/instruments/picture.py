"""A catalogue picture of the set: every part lying in its own studio, photographed from above, with its name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datagen.instruments.catalogue import INSTRUMENTS, Instrument, mesh
from datagen.pictures.photo import develop
from datagen.pictures.renderer import BlenderRenderer
from datagen.scenes.spec import Light, PlacedInstance, SceneSpec, Shot, Solid, Surface, Surroundings
from datagen.scenes.viewpoints import look_at
from multicam.files import write_atomic
from multicam.geometry import se3, so3
from multicam.geometry.camera import Camera
from multicam.progress import Progress
from multicam.types import ImageArray

_COLUMNS = 3
_TILE = (340, 220)
"""Width and height of a part's photograph, pixels."""
_FILL = (0.84, 0.80)
"""Largest share of the photograph's width and height that a part takes."""
_TELE = 6.0
"""Focal length in picture widths: long, so that parts are hardly foreshortened."""
_DPI = 100
_FLOOR = Surface((0.60, 0.625, 0.65), roughness=0.9)
_EXPOSURE = 1.15
_COLORS = 256


def _lying(direction: float, tilt: float, roll: float) -> NDArray[np.float64]:
    """Rotation that lays z along `direction` in the picture, its end raised by `tilt`, after a `roll` (degrees)."""
    return _turned(2, direction) @ _turned(1, 90.0 - tilt) @ _turned(2, roll)


def _turned(axis: int, degrees: float) -> NDArray[np.float64]:
    return so3.exp(np.deg2rad(degrees) * np.eye(3)[axis])


_POSES = {
    "aiming_arm": _lying(145, 14, 148),
    "bar": _turned(2, 26) @ _turned(0, -30),
    "gear": _turned(1, 20) @ _turned(0, -38),
    "insertion_handle": _turned(2, 54) @ _turned(0, -62),
    "nail": _lying(149, 8, 20),
    "roller": _lying(214, 24, 0),
    "screw": _lying(-34, 14, 0),
    "spacer": _turned(2, 24) @ _turned(0, -50),
    "stick": _lying(-34, 12, 0),
}
"""Rotations that show each part from its best side; the camera looks down, y is up in the picture."""


def write_picture(models: Path, output: Path, samples: int, progress: Progress) -> None:
    """Renders the parts of a written models folder and puts the photographs side by side in one PNG.

    Raises:
        MissingDependencyError: bpy, or a system library that it needs, is not installed.
    """
    tiles = []
    with BlenderRenderer(models, samples) as renderer:
        for part in progress.track(INSTRUMENTS, "photographs"):
            scene = studio(part)
            (passes,) = renderer.render(scene, [0])
            tiles.append(develop(passes.color, scene.shots[0], np.random.default_rng(0)))
    _write_sheet(tiles, output)


def studio(part: Instrument) -> SceneSpec:
    """One part on a pale floor; lamps and camera keep their place in relation to its size."""
    rotation = _POSES[part.name]
    points = mesh(part.name).vertices @ rotation.T
    low, high = points.min(0), points.max(0)
    width, height = _TILE
    # The width of the floor in the picture.
    view = max((high[0] - low[0]) / _FILL[0], (high[1] - low[1]) / _FILL[1] * width / height)
    middle = (low + high) / 2
    placed = se3.from_parts(rotation, np.array([-middle[0], -middle[1], 0.01 * view - low[2]]))
    floor = Solid(
        "box",
        np.array([40 * view, 40 * view, 0.02]),
        se3.from_parts(np.eye(3), np.array([0.0, 0.0, -0.01])),
        _FLOOR,
    )
    camera = Camera.from_focal(_TELE * width, width, height)
    above = np.array([0.0, 0.0, _TELE * view + (high[2] - low[2]) / 2])
    return SceneSpec(
        name=part.name,
        seed=0,
        objects=(PlacedInstance(part.obj_id, placed, _surface(part)),),
        solids=(floor,),
        lights=(
            _lamp(view, (-2.8, 3.6, 6.5), 1.5, 300.0),
            _lamp(view, (4.5, 0.0, 2.5), 1.6, 70.0),
            _lamp(view, (0.0, -4.5, 2.8), 2.0, 60.0),
        ),
        surroundings=Surroundings(strength=0.55, hdri="studio"),
        shots=(Shot(camera, look_at(above, np.zeros(3)), exposure=_EXPOSURE),),
    )


def _surface(part: Instrument) -> Surface:
    material = part.material
    return Surface(material.color, metallic=float(material.metallic), roughness=material.roughness)


def _lamp(view: float, position: tuple[float, float, float], radius: float, watts: float) -> Light:
    """A disc lamp turned to the part; lengths in view widths, power for a view one metre wide."""
    place = view * np.array(position)
    # A lamp shines along -z, a camera looks along z.
    world_from_light = look_at(place, np.zeros(3)) @ np.diag([1.0, -1.0, -1.0, 1.0])
    return Light(world_from_light, radius * view, watts * view**2, (1.0, 1.0, 1.0), point=False)


def _write_sheet(tiles: list[ImageArray], output: Path) -> None:
    """Photographs in rows, name and greatest extent under each; a palette keeps the file small."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    width, height = _TILE
    caption, gap = 44, 6
    rows = len(tiles) // _COLUMNS
    size = (_COLUMNS * (width + gap) + gap, rows * (height + caption) + gap)
    figure = Figure(figsize=(size[0] / _DPI, size[1] / _DPI), dpi=_DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    for index, (part, tile) in enumerate(zip(INSTRUMENTS, tiles, strict=True)):
        x = gap + index % _COLUMNS * (width + gap)
        y = gap + index // _COLUMNS * (height + caption)
        figure.figimage(tile, x, size[1] - y - height, origin="upper")
        middle, below = (x + width / 2) / size[0], 1 - (y + height) / size[1]
        line = 16 / size[1]
        title = part.name.replace("_", " ")
        extent = f"{mesh(part.name).diameter() * 1000:.0f} mm"
        figure.text(middle, below - 0.9 * line, title, ha="center", va="center", fontsize=10.5, color="#1c2126")
        figure.text(middle, below - 1.9 * line, extent, ha="center", va="center", fontsize=7.5, color="#6a727a")
    canvas.draw()
    sheet = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    small = sheet.quantize(_COLORS, method=Image.Quantize.MEDIANCUT, kmeans=4, dither=Image.Dither.NONE)
    with write_atomic(output) as temporary:
        small.save(temporary, format="PNG", optimize=True)
