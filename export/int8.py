"""A network file with 8-bit convolutions, by ONNX Runtime's own static quantization."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import onnx
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

from export.to_onnx import finish
from multicam.errors import ModelError
from multicam.image import Letterbox
from multicam.inference.metadata import NetworkMetadata
from multicam.inference.session import INPUT_NAME
from multicam.progress import Progress
from multicam.types import ImageArray

KEPT_SINGLE = ("backbone.stem.", "backbone.stage4.", "backbone.stage8.0.", "head.")
"""Parts of the names of weights whose layers lose more than they save in 8 bits: the first layers, which see fine
detail, and the head, from which scores, boxes and pose vectors come. Measured in docs/export.md."""


def write_int8(
    single: Path, metadata: NetworkMetadata, images: Sequence[ImageArray], path: Path, progress: Progress
) -> None:
    """Writes a file whose convolutions take and give 8-bit numbers; all else stays as in the single-precision file.

    Weights have a scale per channel and values have one per layer, from the least and greatest that the pictures show.

    Args:
        single: file of `write_onnx`.
        metadata: of the new file.
        images: (h, w, 3) uint8 RGB of any sizes, to calibrate on.
    """
    model = onnx.load(single)
    nodes = [
        node.name
        for node in model.graph.node
        if node.op_type == "Conv" and not any(part in name for name in node.input for part in KEPT_SINGLE)
    ]
    if not nodes:
        raise ModelError("the network has no convolution that may be computed in 8 bits; no file was written.")
    quietly = logging.getLogger()
    level = quietly.level
    # ONNX Runtime's tool writes hints for its developers to the root logger.
    quietly.setLevel(logging.ERROR)
    try:
        quantize_static(
            model,
            path,
            _Pictures(images, metadata, progress),
            quant_format=QuantFormat.QDQ,
            nodes_to_quantize=nodes,
            per_channel=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
        )
    finally:
        quietly.setLevel(level)
    finish(onnx.load(path), metadata, path)


class _Pictures(CalibrationDataReader):
    """Letterboxed pictures one by one, as the tool asks for them."""

    def __init__(self, images: Sequence[ImageArray], metadata: NetworkMetadata, progress: Progress) -> None:
        self._batches: Iterator[ImageArray] = (
            Letterbox.fit(image.shape[1], image.shape[0], metadata.width, metadata.height).apply(image)[np.newaxis]
            for image in progress.track(images, "calibrating", len(images))
        )

    def get_next(self) -> dict[str, ImageArray] | None:
        """The next input, or None after the last."""
        batch = next(self._batches, None)
        return None if batch is None else {INPUT_NAME: batch}
