"""What is exported, and how closely it must agree."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from multicam.errors import ConfigError


@dataclass(frozen=True)
class ExportConfig:
    """One network file from one checkpoint."""

    checkpoint: Path = Path("runs/train/best")
    """Checkpoint folder of `multicam train`; its averaged weights are taken."""
    output: Path = Path("runs/train/network.onnx")
    """File to write; it appears only when it agrees with PyTorch."""
    rows: int = 100
    """Best cells of each image that are answered; at least the number of objects in view, a few times over."""
    licence: str = "Apache-2.0"
    """Licence of the weights, written into the file."""
    images: Path | None = None
    """Folder of pictures to compare on besides invented ones; its subfolders are searched."""
    tolerance_px: float = 1e-3
    """Greatest difference between PyTorch and ONNX Runtime, pixels; more for uncertain keypoints and large boxes."""

    def __post_init__(self) -> None:
        if self.rows < 1:
            raise ConfigError(f"rows must be 1 or more; it is {self.rows}.")
        if self.output.suffix != ".onnx":
            raise ConfigError(f"the output must be a file that ends in .onnx; it is {self.output}.")
        if not self.tolerance_px > 0:
            raise ConfigError(f"tolerance_px must be positive; it is {self.tolerance_px}.")
