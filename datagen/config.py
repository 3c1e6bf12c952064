"""What a generated data set looks like; YAML files in configs/datagen/ hold only what differs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from multicam.config import to_mapping
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
    """Focal length in widths of the camera's image."""
    window: float = 1.0
    """Each picture is a window of this share of the sides of the camera's image, at a random place in it: 0.5 with
    320 x 240 pictures trains a network for 640 x 480 ones, at a quarter of the price of those."""
    off_centre: float = 0.25
    """How far from the middle of the picture, in half pictures, the point looked at may lie."""
    focused_fraction: float = 0.3
    """Share of pictures with a small depth of field (randomize.lens)."""
    f_number: Range = (1.4, 5.6)
    """Aperture of these, log-uniform; the lens is as long as the focal length on a sensor 6 mm wide."""
    moving_fraction: float = 0.25
    """Share of pictures blurred by the camera's motion (randomize.motion)."""
    motion: float = 0.012
    """How far the picture moves during the exposure at most, in widths of the picture."""
    rolling_fraction: float = 0.5
    """Share of these whose rows are exposed one after the other."""


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
    upright_fraction: float = 0.0
    """Share of single objects that stand as they were modelled, z up; the others lie as they would fall."""
    classes: tuple[int, ...] = ()
    """Labelled classes (obj_id); all if empty. The other models then lie about as distractors."""
    settle: bool = False
    """Let piles fall under gravity (rigid bodies, about 2 s a scene) instead of lowering parts one by one."""


@dataclass(frozen=True)
class PlacesConfig:
    """Where the objects are, as shares of the scenes (randomize.places; otherwise always on a table)."""

    table: float = 0.5
    """A table in a room."""
    floor: float = 0.15
    """The floor of a room with four walls."""
    box: float = 0.2
    """A bin whose sides hide some of what is in it."""
    air: float = 0.15
    """Nothing beneath them: they float before the background."""


@dataclass(frozen=True)
class AssetsConfig:
    """Folders of one's own pictures and meshes; what Blender and this package bring is used without them."""

    textures: Path | None = None
    """Pictures laid over tables, walls, distractors and overlays; half of all surfaces then have one."""
    backgrounds: Path | None = None
    """Pictures seen behind the objects where nothing else is; half of the scenes then have one."""
    hdris: Path | None = None
    """Environment maps (.hdr, .exr) to use instead of Blender's eight."""
    distractors: Path | None = None
    """Meshes (PLY, OBJ, STL, GLB) of any unit, scaled to the size of a distractor; half of these are then meshes."""


@dataclass(frozen=True)
class RandomizationConfig:
    """Each kind of domain randomisation; false gives a plain, realistic choice instead, or leaves it out."""

    materials: bool = True
    """Objects: wear, other metals, plastic, paint and patterns now and then."""
    textures: bool = True
    """Table, floor and walls: procedural patterns in random colours, or pictures."""
    places: bool = True
    """Table, floor, bin or in the air."""
    distractors: bool = True
    """Up to eight unlabelled things: primitives, gears, meshes, the classes that are not labelled."""
    occluders: bool = True
    """Up to three unlabelled things that hang between the objects and the cameras."""
    overlays: bool = True
    """Patches before the picture, in a third of them; what they hide is not visible in the labels either."""
    backgrounds: bool = True
    """What is seen behind all: the environment, a procedural pattern, or a picture."""
    surroundings: bool = True
    """Environment light: which one, turned, brighter or darker, or a gradient."""
    lights: bool = True
    """Zero to three lamps of random place, size, power and colour temperature."""
    lens: bool = True
    """Depth of field, softness and vignetting."""
    motion: bool = True
    """Motion blur and rolling shutter."""
    exposure: bool = True
    """Brightness and white balance of the picture, and noise of the sensor."""
    compression: bool = True
    """JPEG quality from 55 to 98; 95 otherwise."""


@dataclass(frozen=True)
class DatagenConfig:
    """Renders labelled pictures of a BOP models folder into a BOP data set."""

    models: Path = Path("data/instruments/models")
    """BOP models folder: meshes, models_info.json, keypoints.json and, for groups, assemblies.json; or a folder of CAD
    files with parts.yaml, which is imported first."""
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
    executor: Literal["local", "ray"] = "local"
    """Worker processes on this machine, or on a Ray cluster (RAY_ADDRESS) whose machines share the folders."""
    workers: int = 0
    """Worker processes with a Blender each; 0 for one per four cores. The pictures do not depend on it."""
    camera: CameraConfig = field(default_factory=CameraConfig)
    objects: ObjectsConfig = field(default_factory=ObjectsConfig)
    places: PlacesConfig = field(default_factory=PlacesConfig)
    assets: AssetsConfig = field(default_factory=AssetsConfig)
    randomize: RandomizationConfig = field(default_factory=RandomizationConfig)

    def __post_init__(self) -> None:
        for name in ("images", "images_per_scene", "width", "height", "samples"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must be at least 1.")
        if self.workers < 0:
            raise ConfigError(f"workers is {self.workers}; give how many, or 0 for a number that fits the machine.")
        for name in ("distance", "elevation_deg", "focal", "f_number"):
            low, high = getattr(self.camera, name)
            if not 0 < low <= high:
                raise ConfigError(f"camera.{name} is {low} to {high}; give two positive numbers, the lesser first.")
        if not 0 < self.camera.window <= 1:
            raise ConfigError(
                f"camera.window is {self.camera.window:g}; it is a share of the image, above 0, at most 1."
            )
        if self.camera.elevation_deg[1] > 90:
            raise ConfigError("camera.elevation_deg goes beyond 90 degrees, which is straight above.")
        for part in (self.camera, self.objects):
            for name, share in vars(part).items():
                if name.endswith("_fraction") and not 0 <= share <= 1:
                    raise ConfigError(f"{name} is {share:g}; shares lie between 0 and 1.")
        for name in ("loose", "loose_beside_groups"):
            low, high = getattr(self.objects, name)
            if not 0 <= low <= high or (name == "loose" and low < 1):
                raise ConfigError(f"objects.{name} is {low} to {high}; give the lesser count first, and not 0 loose.")

        shares = to_mapping(self.places)
        if min(shares.values()) < 0 or not sum(shares.values()) > 0:
            raise ConfigError(f"places are shares of the scenes, none below 0 and not all 0; they are {shares}.")
        for kind, folder in vars(self.assets).items():
            if folder is not None and not folder.is_dir():
                raise ConfigError(f"assets.{kind} is {folder}, which is no folder.")

    @property
    def scenes(self) -> int:
        """Number of scenes; the last may have fewer pictures."""
        return -(-self.images // self.images_per_scene)

    def images_in_scene(self, index: int) -> int:
        """Number of pictures of scene `index`, counted from 0; none after the last scene."""
        return max(0, min(self.images_per_scene, self.images - index * self.images_per_scene))
