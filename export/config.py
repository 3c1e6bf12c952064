"""What is exported, and how closely it must agree."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from multicam.errors import ConfigError
from multicam.inference.metadata import Precision


@dataclass(frozen=True)
class LossLimits:
    """What fp16 and int8 may lose against fp32; beyond that no file is written."""

    least_same: float = 0.9
    """Share of the detections of fp32 that must be found again."""
    most_keypoint_px: float = 0.5
    """Pixels of the pictures by which keypoints may move, in the median."""
    most_recall: float = 0.02
    """Share of the objects in a BOP split that may be lost."""

    def __post_init__(self) -> None:
        if not (0 <= self.least_same <= 1 and 0 <= self.most_recall <= 1 and self.most_keypoint_px > 0):
            raise ConfigError(
                "loss.least_same and loss.most_recall must be shares between 0 and 1, loss.most_keypoint_px positive; "
                f"they are {self.least_same}, {self.most_recall} and {self.most_keypoint_px}."
            )


@dataclass(frozen=True)
class ExportConfig:
    """One network file from one checkpoint."""

    checkpoint: Path = Path("runs/train/best")
    """Checkpoint folder of `multicam train`; its averaged weights are taken."""
    output: Path = Path("runs/train/network.onnx")
    """File to write; it appears only when it agrees with PyTorch."""
    precision: Precision = "fp32"
    """fp32; fp16 for graphics cards; int8 for CPUs. Both take about half the space, and lose some accuracy."""
    rows: int = 100
    """Best cells of each image that are answered; at least the number of objects in view, a few times over."""
    licence: str = "Apache-2.0"
    """Licence of the weights, written into the file."""
    images: Path | None = None
    """Pictures to compare on: a folder with its subfolders, or a BOP split, whose truth then gives recall."""
    calibration: Path | None = None
    """BOP split of renders that shows int8 the range of every layer; others than `images`."""
    tolerance_px: float = 1e-3
    """Greatest difference between PyTorch and ONNX Runtime, pixels; more for uncertain keypoints and large boxes."""
    loss: LossLimits = field(default_factory=LossLimits)
    """What fp16 and int8 may lose."""

    def __post_init__(self) -> None:
        if self.rows < 1:
            raise ConfigError(f"rows must be 1 or more; it is {self.rows}.")
        if self.output.suffix != ".onnx":
            raise ConfigError(f"the output must be a file that ends in .onnx; it is {self.output}.")
        if not self.tolerance_px > 0:
            raise ConfigError(f"tolerance_px must be positive; it is {self.tolerance_px}.")
        if self.precision != "fp32" and self.images is None:
            raise ConfigError(
                f"{self.precision} loses accuracy, and only pictures of the objects tell how much; give --images DIR."
            )
        if (self.precision == "int8") != (self.calibration is not None):
            raise ConfigError(
                "int8 needs renders that show the range of every layer; give --calibration DIR, a BOP split."
                if self.precision == "int8"
                else f"only int8 is calibrated, and precision is {self.precision}; leave --calibration out."
            )
