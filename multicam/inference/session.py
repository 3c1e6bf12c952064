"""The network of one ONNX file, run by ONNX Runtime. Format of the file: docs/export.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
from onnxruntime.capi import onnxruntime_pybind11_state as ort_errors  # pyright: ignore[reportAttributeAccessIssue]

from multicam.errors import DataError, ModelError, did_you_mean
from multicam.files import require_file
from multicam.image import Letterbox
from multicam.inference.decode import DecodeConfig, RawDetections, decode
from multicam.inference.metadata import NetworkMetadata
from multicam.types import Detection, ImageArray

METADATA_KEY = "multicam"
INPUT_NAME = "images"
OUTPUT_NAMES = ("boxes", "scores", "labels", "keypoints", "visibility", "std")

PROVIDERS = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "directml": "DmlExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
}
"""Our names of execution providers, and ONNX Runtime's."""

_LOAD_ERRORS = (
    ort_errors.EPFail,
    ort_errors.Fail,
    ort_errors.InvalidArgument,
    ort_errors.InvalidGraph,
    ort_errors.InvalidProtobuf,
    ort_errors.NotImplemented,
    ort_errors.RuntimeException,
)


@dataclass(frozen=True)
class SessionConfig:
    """Where and how the network runs."""

    provider: str = "cpu"
    """Execution provider: cpu, cuda, tensorrt, openvino, directml or coreml; never replaced silently."""
    threads: int = 0
    """CPU threads of one operator; 0 takes all cores."""


class Network:
    """A network file, checked and ready to run."""

    def __init__(self, path: Path, config: SessionConfig | None = None) -> None:
        """Opens a network file.

        Raises:
            ModelError: no such file, not ONNX, not ours, of another format version, with inputs or outputs that do
                not fit its metadata, or an execution provider that is not there.
        """
        config = config or SessionConfig()
        self.path = path
        self._session = _open(path, config)
        self.metadata = _read_metadata(self._session, path)
        _check_signature(self._session, self.metadata, path)
        self._obj_ids = self.metadata.catalogue().obj_ids

    def detect(self, images: Sequence[ImageArray], config: DecodeConfig | None = None) -> list[list[Detection]]:
        """Finds the objects of several images, of any sizes, in one batch.

        Args:
            images: each (h, w, 3) uint8 RGB.

        Returns:
            For each image its detections, best score first, in pixels of that image.
        """
        if not images:
            return []
        config = config or DecodeConfig()
        size = self.metadata.width, self.metadata.height
        letterboxes = [Letterbox.fit(image.shape[1], image.shape[0], *size) for image in images]
        batch = np.stack([box.apply(image) for box, image in zip(letterboxes, images, strict=True)])
        outputs = self.run(batch)
        return [
            decode(RawDetections(*(output[i] for output in outputs)), letterbox, self._obj_ids, config)
            for i, letterbox in enumerate(letterboxes)
        ]

    def run(self, batch: ImageArray) -> list[Any]:
        """Raw outputs in the order of OUTPUT_NAMES for a letterboxed batch (B, H, W, 3) uint8 RGB."""
        return list(self._session.run(list(OUTPUT_NAMES), {INPUT_NAME: batch}))


def _open(path: Path, config: SessionConfig) -> ort.InferenceSession:
    try:
        require_file(path, "network file")
    except DataError as error:
        raise ModelError(str(error)) from error
    provider = _require_provider(config.provider)
    options = ort.SessionOptions()
    options.intra_op_num_threads = config.threads
    # Errors reach the user as exceptions; ONNX Runtime need not print them too.
    options.log_severity_level = 4
    try:
        session = ort.InferenceSession(str(path), options, providers=[provider])
    except _LOAD_ERRORS as error:
        raise ModelError(
            f"{path} cannot be opened as an ONNX network (is it damaged or cut short?): {_first_line(error)}"
        ) from error
    if session.get_providers()[0] != provider:
        raise ModelError(
            f'the execution provider "{config.provider}" is built in but did not start (are its drivers and '
            'libraries installed?); choose "cpu" to run without it.'
        )
    session.disable_fallback()
    return session


def _require_provider(name: str) -> str:
    available = [ours for ours, theirs in PROVIDERS.items() if theirs in ort.get_available_providers()]
    if name not in PROVIDERS:
        raise ModelError(
            f'unknown execution provider "{name}"{did_you_mean(name, PROVIDERS)}; there are {", ".join(PROVIDERS)}.'
        )
    if name not in available:
        raise ModelError(
            f'this ONNX Runtime has no execution provider "{name}", only {", ".join(available)}; install the '
            "onnxruntime package that carries it (onnxruntime-gpu for cuda and tensorrt)."
        )
    return PROVIDERS[name]


def _read_metadata(session: ort.InferenceSession, path: Path) -> NetworkMetadata:
    text = session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
    if text is None:
        raise ModelError(
            f'{path} is an ONNX file but not one of ours: it lacks the metadata entry "{METADATA_KEY}"; '
            "`multicam export` writes files that have it."
        )
    return NetworkMetadata.from_json(text, str(path))


def _check_signature(session: ort.InferenceSession, metadata: NetworkMetadata, path: Path) -> None:
    """Compares names, types and fixed sizes of inputs and outputs with the metadata; batch and row count are free."""
    found = {node.name: (node.type, tuple(node.shape)) for node in (*session.get_inputs(), *session.get_outputs())}
    keypoints = metadata.num_keypoints
    expected: dict[str, tuple[str, tuple[int | None, ...]]] = {
        INPUT_NAME: ("tensor(uint8)", (None, metadata.height, metadata.width, 3)),
        "boxes": ("tensor(float)", (None, None, 4)),
        "scores": ("tensor(float)", (None, None)),
        "labels": ("tensor(int64)", (None, None)),
        "keypoints": ("tensor(float)", (None, None, keypoints, 2)),
        "visibility": ("tensor(float)", (None, None, keypoints)),
        "std": ("tensor(float)", (None, None, keypoints, 2)),
    }
    for name, (kind, shape) in expected.items():
        if name not in found:
            raise ModelError(f'{path} has no "{name}" among its inputs and outputs {", ".join(found)}.')
        if found[name][0] != kind or not _fits(found[name][1], shape):
            raise ModelError(
                f'{path}: "{name}" is {found[name][0]} {list(found[name][1])}, its metadata says {kind} '
                f"{['any' if side is None else side for side in shape]}."
            )
    if len(session.get_inputs()) != 1:
        names = ", ".join(node.name for node in session.get_inputs())
        raise ModelError(f'{path} wants the inputs {names}; a network of ours has the one input "{INPUT_NAME}".')


def _fits(found: tuple[Any, ...], expected: tuple[int | None, ...]) -> bool:
    """Whether shapes agree; a side of None may be anything, dynamic sides (named by ONNX) included."""
    return len(found) == len(expected) and all(e in (None, f) for f, e in zip(found, expected, strict=True))


def _first_line(error: BaseException) -> str:
    return str(error).strip().splitlines()[0].rstrip(".") + "."
