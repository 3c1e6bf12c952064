"""Writes a deployed detector as one ONNX file: weights, graph and metadata, no files beside it."""

from __future__ import annotations

import warnings
from pathlib import Path

import onnx
import torch

from export.wrapper import DeployDetector
from multicam import __version__
from multicam.inference.metadata import NetworkMetadata
from multicam.inference.session import INPUT_NAME, METADATA_KEY, OUTPUT_NAMES

OPSET = 18
"""The oldest operator set that the exporter writes without conversion."""


def write_onnx(detector: DeployDetector, metadata: NetworkMetadata, path: Path) -> None:
    """Writes the file; only the batch is dynamic, height and width are those of the metadata."""
    # A batch of one would be taken for a constant.
    example = torch.zeros((2, metadata.height, metadata.width, 3), dtype=torch.uint8)
    with warnings.catch_warnings():
        # PyTorch deprecates its own helpers inside the exporter; nothing a user could act on.
        warnings.simplefilter("ignore", FutureWarning)
        warnings.simplefilter("ignore", DeprecationWarning)
        program = torch.onnx.export(
            detector,
            (example,),
            input_names=[INPUT_NAME],
            output_names=list(OUTPUT_NAMES),
            dynamic_shapes={INPUT_NAME: {0: torch.export.Dim("batch", min=1, max=1024)}},
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    assert program is not None, "the dynamo exporter returns the program"
    finish(program.model_proto, metadata, path)


def finish(model: onnx.ModelProto, metadata: NetworkMetadata, path: Path) -> None:
    """Writes a model with our metadata and no other, checked; only what concerns its user is kept."""
    _forget_origin(model.graph)
    model.producer_name, model.producer_version = "multicam-pose", __version__
    onnx.helper.set_model_props(model, {METADATA_KEY: metadata.to_json()})
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, path)


def _forget_origin(graph: onnx.GraphProto) -> None:
    """Removes the exporter's stack traces: a fifth of a small file, with paths of the machine it was made on."""
    for item in (graph, *graph.node, *graph.input, *graph.output, *graph.value_info, *graph.initializer):
        del item.metadata_props[:]
        item.doc_string = ""
