"""What a generated data set looks like; YAML files in configs/datagen/ hold only what differs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from multicam.errors import ConfigError

Range = tuple[float, float]


@dataclass(frozen=True)
class CameraConfig:
    """Where cameras stand and how they see."""

    distance: Range = (0.25, 1.5)
    """Metres from the point looked at, log-uniform."""
    elevation_deg: Range = (12.0, 85.0)
    """Above the table; uniform over the part of the sphere."""
    roll_deg: float = 35.0
    """Greatest turn about the optical axis, either way."""
    focal: Range = (0.9, 1.4)
    """Focal length in image widths."""
    off_centre: float = 0.25
    """How far from the image centre, in half images, the point looked at may lie."""


@dataclass(frozen=True)
class ObjectsConfig:
    """What stands on the table."""

    assembled_fraction: float = 0.5
    """Share of scenes with mounted groups (from assemblies.json)."""
    loose: tuple[int, int] = (4, 9)
    """Single objects in a scene without groups."""
    loose_beside_groups: tuple[int, int] = (1, 4)
    """Single objects in a scene with groups."""
    pile_fraction: float = 0.35
    """Share of scenes in which objects lie close and on top of each other."""
    air_fraction: float = 0.1
    """Share of objects that hang in the air, turned any way."""


@dataclass(frozen=True)
class RandomizationConfig:
    """Each kind of domain randomisation; false gives a plain, realistic choice instead."""

    materials: bool = True
    """Objects: paint, other metals and patterns now and then."""
    textures: bool = True
    """Table, floor and walls: procedural patterns in random colours."""
    surroundings: bool = True
    """Environment light: which one, turned, brighter or darker, or a gradient."""
    lights: bool = True
    """Zero to three lamps of random place, size, power and colour."""
    distractors: bool = True
    """Up to eight unlabelled primitives."""
    exposure: bool = True
    """Brightness of the picture and noise of the sensor."""


@dataclass(frozen=True)
class DatagenConfig:
    """Renders labelled pictures of a BOP models folder into a BOP data set."""

    models: Path = Path("data/instruments/models")
    """BOP models folder: meshes, models_info.json, keypoints.json and, for groups, assemblies.json."""
    output: Path = Path("data/instruments")
    """Data set folder; the models are copied beside the split if they are not there yet."""
    split: str = "train"
    """Name of the split folder."""
    images: int = 1000
    """How many pictures in all."""
    images_per_scene: int = 15
    """Pictures of one arrangement; all of them share a world."""
    width: int = 320
    """Pixels."""
    height: int = 240
    """Pixels."""
    samples: int = 4
    """Paths per pixel before denoising; 4 is good, 8 very good, cost is linear."""
    seed: int = 0
    """With the number of a scene, decides everything in it."""
    camera: CameraConfig = field(default_factory=CameraConfig)
    objects: ObjectsConfig = field(default_factory=ObjectsConfig)
    randomize: RandomizationConfig = field(default_factory=RandomizationConfig)

    def __post_init__(self) -> None:
        for name in ("images", "images_per_scene", "width", "height", "samples"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must be at least 1.")
        for name in ("distance", "elevation_deg", "focal"):
            low, high = getattr(self.camera, name)
            if not 0 < low <= high:
                raise ConfigError(f"camera.{name} is {low} to {high}; give two positive numbers, the lesser first.")
        if self.camera.elevation_deg[1] > 90:
            raise ConfigError("camera.elevation_deg goes beyond 90 degrees, which is straight above.")
        for name in ("loose", "loose_beside_groups"):
            low, high = getattr(self.objects, name)
            if not 0 <= low <= high or (name == "loose" and low < 1):
                raise ConfigError(f"objects.{name} is {low} to {high}; give the lesser count first, and not 0 loose.")

    @property
    def scenes(self) -> int:
        """Number of scenes; the last may have fewer pictures."""
        return -(-self.images // self.images_per_scene)

    def images_in_scene(self, index: int) -> int:
        """Number of pictures of scene `index`, counted from 0."""
        return min(self.images_per_scene, self.images - index * self.images_per_scene)
