"""A checkpoint as the network to deploy and the metadata to ship with it."""

from __future__ import annotations

from typing import Any

from export.config import ExportConfig
from export.wrapper import DeployDetector
from models.detector import Detector
from multicam.errors import ModelError
from multicam.files import require_folder
from multicam.inference.metadata import NetworkMetadata
from train.checkpoint import RunState, load_state, load_weights


def load_deployable(config: ExportConfig) -> tuple[DeployDetector, NetworkMetadata]:
    """The checkpoint's network in its deployed form, and what its file will say of it.

    Raises:
        MulticamError: the checkpoint is missing, damaged or does not fit together.
    """
    folder = require_folder(config.checkpoint, "checkpoint folder")
    model_config, catalogue, weights = load_weights(folder)
    state = load_state(folder)
    detector = Detector(model_config)
    try:
        detector.load_state_dict(weights)
    except RuntimeError as error:
        raise ModelError(
            f"the weights in {folder} do not fit its model.json: {str(error).splitlines()[-1].strip()}"
        ) from error
    objects = tuple(catalogue.objects.values())
    if len(objects) != model_config.num_classes:
        raise ModelError(
            f"{folder}: objects.json names {len(objects)} classes, the network has {model_config.num_classes}."
        )
    metadata = NetworkMetadata(
        objects, state.input_width, state.input_height, config.licence, _summary(detector, state)
    )
    cells = sum((state.input_width // s) * (state.input_height // s) for s in model_config.strides)
    return DeployDetector(detector, min(config.rows, cells)), metadata


def _summary(detector: Detector, state: RunState) -> dict[str, Any]:
    config = detector.config
    return {
        "network": f"{config.size}, {config.neck}, strides {', '.join(map(str, config.strides))}",
        "epochs": state.epoch,
        "validation": state.metrics,
    }
