"""What a recording looks like."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

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
class SequenceConfig:
    """Renders a recording: a moving headset and two static cameras around one table.

    The objects lie in two clusters. Each static camera sees one of them, never anything of the other; the headset
    looks from one to the other and so links cameras that share no object.
    """

    models: Path = Path("data/instruments/models")
    """BOP models folder; it is copied into the recording."""
    output: Path = Path("data/sequence")
    """Folder of the recording."""
    steps: int = 40
    """Pictures of each camera."""
    rate_hz: float = 5.0
    """Pictures a second."""
    turns: float = 1.0
    """How often the headset goes from the left cluster to the right and back."""
    assembled: bool = False
    """Whether the left cluster is a mounted group (from assemblies.json)."""
    width: int = 320
    """Pixels."""
    height: int = 240
    """Pixels."""
    focal: float = 1.1
    """Focal length in image widths, roughly; the three cameras differ by a few percent."""
    distance: Range = (0.5, 0.75)
    """Metres from the static cameras to their cluster; the headset keeps to the middle of it."""
    spacing: float = 0.8
    """Metres between the clusters."""
    clock_offset_ms: float = 4.0
    """Greatest constant offset of a camera's exposures from the common rhythm."""
    clock_jitter_ms: float = 1.0
    """Standard deviation of each exposure about it."""
    samples: int = 8
    """Paths per pixel before denoising."""
    seed: int = 0
    """Decides everything in the recording."""
    drift: DriftConfig = field(default_factory=DriftConfig)

    def __post_init__(self) -> None:
        for name in ("steps", "width", "height", "samples"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must be at least 1.")
        for name in ("rate_hz", "focal", "spacing", "turns"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must be more than 0.")
        if not 0 < self.distance[0] <= self.distance[1]:
            raise ConfigError("distance must be two positive numbers, the lesser first.")
