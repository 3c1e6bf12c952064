"""What a recording looks like."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from datagen.config import Range
from multicam.errors import ConfigError


@dataclass(frozen=True)
class DriftConfig:
    """Errors of the headset's own tracking: each step of its true motion is multiplied by a small twist."""

    rotation_bias_deg: float = 0.02
    """Turn per second about one fixed random axis."""
    translation_bias_mm: float = 0.6
    """Shift per second in one fixed random direction."""
    rotation_walk_deg: float = 0.08
    """Random walk, degrees per root second and axis."""
    translation_walk_mm: float = 1.5
    """Random walk, millimetres per root second and axis."""


@dataclass(frozen=True)
class ClockConfig:
    """When pictures are taken, and how wrong the time stamps are. The headset's clock is the true one."""

    phase_ms: float = 4.0
    """Greatest shift of a camera's exposures against the common rhythm, either way; the time stamps tell it."""
    jitter_ms: float = 1.0
    """Standard deviation of each exposure about its rhythm; the time stamps tell it."""
    offset_ms: float = 2.0
    """Greatest error of a static camera's time stamps, either way: a constant that nobody is told."""
    lost: float = 0.0
    """Share of its frames that each camera loses; the first is never lost."""


@dataclass(frozen=True)
class DepthConfig:
    """Errors of the static cameras' depth, which is aligned to their colour; defaults are Azure-Kinect-like."""

    shift_px: float = 0.25
    """Standard deviation of the sideways error of each measurement, pixels."""
    noise_mm: float = 0.5
    """Standard deviation of the depth up to half a metre."""
    noise_mm_per_m: float = 1.0
    """By which it grows with every metre beyond."""
    edge_m: float = 0.8
    """No depth where the 3x3 neighbourhood spans more than this."""
    dark: float = 15 / 255
    """No depth where the picture is darker than this, of 1."""
    range_m: Range = (0.25, 5.5)
    """No depth nearer or farther."""
    step_mm: float = 1.0
    """Depths are multiples of this."""


@dataclass(frozen=True)
class BumpConfig:
    """A static camera is knocked between two pictures and stays where it is then."""

    at_s: float | None = None
    """Seconds after the beginning; null: never."""
    camera: Literal["left", "right"] = "left"
    """Which one."""
    shift_mm: float = 30.0
    """By how much, in a random direction."""
    turn_deg: float = 3.0
    """By how much, about a random axis through the camera."""


@dataclass(frozen=True)
class MoveConfig:
    """An object is lifted and put elsewhere on the table."""

    at_s: float | None = None
    """Seconds after the beginning; null: never."""
    seconds: float = 1.2
    """How long it is seen moving; 0: it moves between two pictures."""
    distance: Range = (0.06, 0.25)
    """Metres from its old to its new place."""


@dataclass(frozen=True)
class CarryConfig:
    """A small object is carried about above its cluster all the time; whoever carries it is not in the picture."""

    reach_mm: float = 0.0
    """Standard deviation of its way from the middle; 0: nothing is carried."""
    tilt_deg: float = 12.0
    """Standard deviation of its tilt; it turns about the vertical four times as far."""


@dataclass(frozen=True)
class SequenceConfig:
    """Renders a recording: a moving headset and two static RGB-D cameras around one table.

    With the layout "apart" the objects lie in two clusters. Each static camera sees one of them, never anything of
    the other; the headset looks from one to the other and so links cameras that share no object. With "overlapping"
    there is one cluster, which both static cameras see.
    """

    models: Path = Path("data/instruments/models")
    """BOP models folder; it is copied into the recording."""
    output: Path = Path("data/sequence")
    """Folder of the recording."""
    steps: int = 40
    """Pictures of each camera."""
    rate_hz: float = 5.0
    """Pictures a second."""
    layout: Literal["apart", "overlapping"] = "apart"
    """Whether the static cameras share objects."""
    turns: float = 1.0
    """How often the headset goes from the left cluster to the right and back."""
    assembled: bool = False
    """Whether the left cluster holds a mounted group (from assemblies.json)."""
    width: int = 320
    """Pixels."""
    height: int = 240
    """Pixels."""
    focal: float = 1.1
    """Focal length in image widths, roughly; the three cameras differ by a few percent."""
    distance: Range = (0.5, 0.75)
    """Metres from the static cameras to their cluster; the headset keeps to the middle of it."""
    spacing: float = 0.8
    """Metres between the clusters that lie apart."""
    radius: float = 0.15
    """Metres around the middle of a cluster in which its objects lie, or more where there is no room."""
    distractors: int = 4
    """Unlabelled things beside the objects."""
    board: bool = False
    """A 5x4 ChArUco board with 50 mm squares that every camera sees at some time."""
    samples: int = 8
    """Paths per pixel before denoising."""
    seed: int = 0
    """Decides everything in the recording."""
    drift: DriftConfig = field(default_factory=DriftConfig)
    clocks: ClockConfig = field(default_factory=ClockConfig)
    depth: DepthConfig = field(default_factory=DepthConfig)
    bump: BumpConfig = field(default_factory=BumpConfig)
    move: MoveConfig = field(default_factory=MoveConfig)
    carry: CarryConfig = field(default_factory=CarryConfig)

    def __post_init__(self) -> None:
        for name in ("steps", "width", "height", "samples"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must be at least 1.")
        for name in ("rate_hz", "focal", "spacing", "turns", "radius"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must be more than 0.")
        for name, (low, high) in {"distance": self.distance, "move.distance": self.move.distance}.items():
            if not 0 < low <= high:
                raise ConfigError(f"{name} must be two positive numbers, the lesser first.")
        if not 0 <= self.clocks.lost < 1:
            raise ConfigError(f"clocks.lost is {self.clocks.lost}; it must be a share of 0 or more, below 1.")
        for name, at in {"bump.at_s": self.bump.at_s, "move.at_s": self.move.at_s}.items():
            if at is not None and not 0 < at < self.duration:
                raise ConfigError(f"{name} is {at}; the recording lasts from 0 to {self.duration:g} s.")

        if self.move.at_s is not None and not self.move.at_s + self.move.seconds < self.duration:
            raise ConfigError(
                f"move ends {self.move.seconds:g} s after {self.move.at_s:g} s; the recording is over at "
                f"{self.duration:g} s."
            )

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.steps / self.rate_hz
