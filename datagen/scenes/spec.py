"""What a scene holds, as plain data: no Blender here. `sample.py` makes it, `datagen/blender/build.py` shows it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import cattrs
import numpy as np
from numpy.typing import NDArray

from multicam.geometry.camera import Camera

Color = tuple[float, float, float]
"""Linear RGB in 0..1."""


@dataclass(frozen=True)
class Surface:
    """How a thing looks.

    Attributes:
        color, second: linear RGB; a pattern goes from one to the other.
        pattern: plain, noise, voronoi, brick, wave or checker.
        scale: of the pattern, repeats per metre.
        metallic, roughness: 0..1, of a Principled BSDF.
        roughness_spread: how far fine noise moves the roughness, up and down.
        bump: strength in 0..1 with which the pattern bends the shading.
        original: the mesh's own colours or texture, where it has some, instead of `color`.
        picture: image file laid over the thing instead of `color`, once from end to end of its box, or None.
    """

    color: Color
    second: Color = (0.0, 0.0, 0.0)
    pattern: str = "plain"
    scale: float = 10.0
    metallic: float = 0.0
    roughness: float = 0.5
    roughness_spread: float = 0.0
    bump: float = 0.0
    original: bool = False
    picture: str | None = None


@dataclass(frozen=True, eq=False)
class PlacedInstance:
    """One labelled object; its label index is its place in `SceneSpec.objects`."""

    obj_id: int
    world_from_object: NDArray[np.float64]
    surface: Surface


@dataclass(frozen=True, eq=False)
class Solid:
    """An unlabelled primitive: table, wall or distractor.

    Attributes:
        shape: box, cylinder, cone, sphere or torus, of unit size about its centre.
        size: (3,) metres, scales the unit shape.
    """

    shape: str
    size: NDArray[np.float64]
    world_from_solid: NDArray[np.float64]
    surface: Surface


@dataclass(frozen=True, eq=False)
class Light:
    """A lamp; a disc of `radius` metres that shines along its -z axis, or a ball if `point`."""

    world_from_light: NDArray[np.float64]
    radius: float
    watts: float
    color: Color
    point: bool


@dataclass(frozen=True)
class Surroundings:
    """Light from all around: a bundled HDRI by name, or a gradient from horizon to zenith.

    Attributes:
        turn: radians about the vertical.
    """

    strength: float
    hdri: str | None = None
    turn: float = 0.0
    horizon: Color = (0.5, 0.5, 0.5)
    zenith: Color = (0.9, 0.9, 0.9)


@dataclass(frozen=True, eq=False)
class Moved:
    """A labelled object that stands elsewhere in one shot; `index` is its place in `SceneSpec.objects`."""

    index: int
    world_from_object: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Shot:
    """One picture to take.

    Attributes:
        moved: objects that are not where the scene has them.
        exposure: stops above (+) or below (-) a well exposed picture.
        noise: standard deviation of the sensor noise at full scale, in 0..1 of the output range.
    """

    camera: Camera
    world_from_camera: NDArray[np.float64]
    exposure: float = 0.0
    noise: float = 0.0
    moved: tuple[Moved, ...] = ()


@dataclass(frozen=True, eq=False)
class SceneSpec:
    """Everything a renderer needs; all cameras share the world, z up, table top at z = 0.

    Attributes:
        name: says in messages where the scene came from, for example "seed 3, scene 12".
        seed: of the renderer's own noise.
    """

    name: str
    seed: int
    objects: tuple[PlacedInstance, ...]
    solids: tuple[Solid, ...]
    lights: tuple[Light, ...]
    surroundings: Surroundings
    shots: tuple[Shot, ...] = field(default=())

    def objects_in(self, shot: int) -> tuple[PlacedInstance, ...]:
        """The labelled objects where they stand in a shot."""
        placed = list(self.objects)
        for moved in self.shots[shot].moved:
            placed[moved.index] = replace(placed[moved.index], world_from_object=moved.world_from_object)
        return tuple(placed)


def scene_to_plain(scene: SceneSpec) -> dict[str, Any]:
    """The scene as lists, numbers and strings, ready for JSON; float64 survives exactly."""
    return _converter().unstructure(scene)


def scene_from_plain(plain: dict[str, Any]) -> SceneSpec:
    """Inverse of `scene_to_plain`."""
    return _converter().structure(plain, SceneSpec)


def _converter() -> cattrs.Converter:
    converter = cattrs.Converter()
    converter.register_structure_hook_func(_is_array, lambda value, _: np.array(value, dtype=np.float64))
    converter.register_unstructure_hook_func(_is_array, lambda value: value.tolist())
    return converter


def _is_array(kind: Any) -> bool:
    return getattr(kind, "__origin__", kind) is np.ndarray
