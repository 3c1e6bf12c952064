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
    """One labelled object; its label index is its place in `SceneSpec.objects`. `mounted`: it is part of a group."""

    obj_id: int
    world_from_object: NDArray[np.float64]
    surface: Surface
    mounted: bool = False


@dataclass(frozen=True, eq=False)
class Solid:
    """An unlabelled thing: table, wall, distractor or occluder.

    Attributes:
        shape: a name in `primitives.SHAPES` or the path of a mesh file; either is scaled to fill the unit cube about
            the origin.
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
    """Light from all around: an environment map, or a gradient from horizon to zenith.

    Attributes:
        hdri: one of `looks.HDRIS`, which come with Blender, or the path of a file.
        turn: radians about the vertical.
        backdrop: what cameras see instead of where the light comes from, once over the picture, or None.
    """

    strength: float
    hdri: str | None = None
    turn: float = 0.0
    horizon: Color = (0.5, 0.5, 0.5)
    zenith: Color = (0.9, 0.9, 0.9)
    backdrop: Surface | None = None


@dataclass(frozen=True)
class Lens:
    """What a lens does to a picture beside projecting it.

    Attributes:
        softness: standard deviation of its blur, pixels.
        vignette: share of the light that is lost in the corners.
        focus: distance of what is sharp, metres; f_number: aperture on a sensor SENSOR_WIDTH wide, 0 for a pinhole.
    """

    softness: float = 0.0
    vignette: float = 0.0
    focus: float = 1.0
    f_number: float = 0.0


@dataclass(frozen=True, eq=False)
class Motion:
    """How a camera moves while it takes a picture; its pose is that in the middle of the exposure.

    Attributes:
        twist: (6,) right tangent of world_from_camera over the whole exposure.
        row_share: share of that time for which one row is exposed, the first row first; 1: all rows at once.
    """

    twist: NDArray[np.float64]
    row_share: float = 1.0


@dataclass(frozen=True, eq=False)
class Overlay:
    """A patch right before the camera; what it hides is not visible.

    Attributes:
        outline: (n, 2) pixels.
        color: relative to a bright place of the picture.
        picture: image file stretched over the patch instead of `color`, or None.
    """

    outline: NDArray[np.float64]
    color: Color
    picture: str | None = None


SENSOR_WIDTH = 0.006
"""Metres; small cameras' sensors are about this wide, which decides how deep their depth of field is."""


@dataclass(frozen=True, eq=False)
class Moved:
    """A labelled object that stands elsewhere in one shot; `index` is its place in `SceneSpec.objects`."""

    index: int
    world_from_object: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Shot:
    """One picture to take.

    Attributes:
        exposure: stops above (+) or below (-) a well exposed picture.
        noise: standard deviation of the sensor noise at full scale, in 0..1 of the output range.
        moved: objects that are not where the scene has them.
        motion: None for a camera that stands still.
        white: gains of the three channels that a wrong white balance leaves.
        jpeg: quality of the stored picture, 0..100.
    """

    camera: Camera
    world_from_camera: NDArray[np.float64]
    exposure: float = 0.0
    noise: float = 0.0
    moved: tuple[Moved, ...] = ()
    lens: Lens = field(default_factory=Lens)
    motion: Motion | None = None
    overlays: tuple[Overlay, ...] = ()
    white: Color = (1.0, 1.0, 1.0)
    jpeg: int = 95


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
