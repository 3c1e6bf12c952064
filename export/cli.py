"""`multicam export`: a checkpoint in, one checked ONNX file out."""

from __future__ import annotations

import logging
from pathlib import Path

from export.checkpoint import load_deployable
from export.config import ExportConfig
from export.parity import Parity, compare
from export.to_onnx import write_onnx
from multicam.config import parse_command, save_config
from multicam.dataset.bop_reader import IMAGE_SUFFIXES, read_image
from multicam.errors import DataError
from multicam.files import require_folder, write_atomic
from multicam.inference.session import Network
from multicam.types import ImageArray

_MOST_IMAGES = 12
"""Pictures compared, spread over the folder; more show nothing new."""

_NOISY = ("onnxscript", "onnx_ir")
"""Libraries of the exporter that log every node they touch."""

log = logging.getLogger(__name__)


def main(argv: list[str]) -> None:
    """Entry point of the subcommand.

    Raises:
        MulticamError: an unusable checkpoint or configuration, or a file that disagrees with PyTorch.
    """
    for name in _NOISY:
        logging.getLogger(name).setLevel(logging.WARNING)
    config = parse_command(ExportConfig, argv, "multicam export", "Writes a trained detector as one ONNX file.")
    parity = export(config)
    save_config(config, config.output.with_suffix(".yaml"))
    log.info("%s: %.1f MB", config.output, config.output.stat().st_size / 1e6)
    log.info(
        "greatest difference from PyTorch: boxes %.1e px, keypoints %.1e px, std %.1e px, scores %.1e",
        parity.boxes,
        parity.keypoints,
        parity.std,
        parity.scores,
    )


def export(config: ExportConfig) -> Parity:
    """Writes the file, which appears only when it agrees with PyTorch; a file that was there before stays till then.

    Returns:
        The differences found.

    Raises:
        MulticamError: an unusable checkpoint, or a file that disagrees.
    """
    detector, metadata = load_deployable(config)
    images = read_images(config.images) if config.images else []
    with write_atomic(config.output) as temporary:
        write_onnx(detector, metadata, temporary)
        parity = compare(detector, Network(temporary), images)
        parity.require(config.tolerance_px)
    return parity


def read_images(folder: Path) -> list[ImageArray]:
    """Up to a dozen pictures of a folder and its subfolders.

    Raises:
        DataError: no folder, no pictures, or a damaged one.
    """
    require_folder(folder, "folder of pictures")
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in IMAGE_SUFFIXES)
    if not paths:
        raise DataError(f"{folder} holds no pictures ({', '.join(IMAGE_SUFFIXES)}).")
    step = max(1, len(paths) // _MOST_IMAGES)
    return [read_image(path) for path in paths[::step][:_MOST_IMAGES]]
