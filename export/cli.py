"""`multicam export`: a checkpoint in, one checked ONNX file out; `multicam export table`: what each network costs."""

from __future__ import annotations

import logging
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

from export import table
from export.checkpoint import load_deployable
from export.config import ExportConfig
from export.half import halved
from export.int8 import write_int8
from export.loss import Loss, measure_loss
from export.parity import Parity, compare
from export.pictures import read_pictures, read_split
from export.to_onnx import write_onnx
from export.wrapper import DeployDetector
from multicam.config import parse_command, save_config
from multicam.files import write_atomic
from multicam.inference.metadata import NetworkMetadata
from multicam.inference.session import Network
from multicam.progress import Progress, RichProgress, SilentProgress
from multicam.spread import spread

_MOST_COMPARED = 12
"""Pictures compared with PyTorch; more show nothing new."""

_MOST_JUDGED = 200
"""Pictures on which the loss of fp16 and int8 is measured."""

_MOST_CALIBRATED = 100
"""Pictures that show int8 its ranges."""

_NOISY = ("onnxscript", "onnx_ir")
"""Libraries of the exporter that log every node they touch."""

_DESCRIPTION = (
    "Writes a trained detector as one ONNX file. `multicam export table` lists what networks of all sizes cost."
)

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Report:
    """What was found of a file: fp32 against PyTorch, and of fp16 and int8 what they lose against fp32."""

    parity: Parity
    loss: Loss | None


def main(argv: list[str]) -> None:
    """Entry point of the subcommand.

    Raises:
        MulticamError: an unusable checkpoint or configuration, a file that disagrees with PyTorch or loses too much.
    """
    for name in _NOISY:
        logging.getLogger(name).setLevel(logging.WARNING)
    if argv[:1] == ["table"]:
        table.main(argv[1:])
        return
    config = parse_command(ExportConfig, argv, "multicam export", _DESCRIPTION)
    report = export(config, RichProgress())
    save_config(config, config.output.with_suffix(".yaml"))
    log.info("%s: %.1f MB", config.output, config.output.stat().st_size / 1e6)
    parity = report.parity
    log.info(
        "fp32, greatest difference from PyTorch: boxes %.1e px, keypoints %.1e px, std %.1e px, scores %.1e",
        parity.boxes,
        parity.keypoints,
        parity.std,
        parity.scores,
    )
    for line in report.loss.lines() if report.loss else ():
        log.info("%s %s", config.precision, line)


def export(config: ExportConfig, progress: Progress | None = None) -> Report:
    """Writes the file, which appears only when it is as good as asked; a file that was there before stays till then.

    Raises:
        MulticamError: an unusable checkpoint, a file that disagrees with PyTorch or loses too much.
    """
    progress = progress or SilentProgress()
    detector, metadata = load_deployable(config)
    pictures = read_pictures(config.images, _MOST_JUDGED) if config.images else []
    with write_atomic(config.output) as target, tempfile.TemporaryDirectory() as scratch:
        single = target if config.precision == "fp32" else Path(scratch) / "fp32.onnx"
        write_onnx(detector, metadata, single)
        network = Network(single)
        parity = compare(detector, network, [picture.image for picture in spread(pictures, _MOST_COMPARED)])
        parity.require(config.tolerance_px)
        if config.precision == "fp32":
            return Report(parity, None)
        _write_smaller(config, detector, metadata, single, target, progress)
        loss = measure_loss(network, Network(target), pictures, progress)
        loss.require(config.loss)
    return Report(parity, loss)


def _write_smaller(
    config: ExportConfig,
    detector: DeployDetector,
    metadata: NetworkMetadata,
    single: Path,
    target: Path,
    progress: Progress,
) -> None:
    """Writes fp16 or int8; int8 is made from the single-precision file."""
    metadata = replace(metadata, precision=config.precision)
    if config.calibration is None:
        write_onnx(halved(detector), metadata, target)
        return
    images = [picture.image for picture in read_split(config.calibration, _MOST_CALIBRATED)]
    write_int8(single, metadata, images, target, progress)
