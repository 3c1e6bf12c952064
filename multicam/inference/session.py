"""The network of one ONNX file, run by ONNX Runtime. Format of the file: docs/export.md."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
from onnxruntime.capi import onnxruntime_pybind11_state as ort_errors  # pyright: ignore[reportAttributeAccessIssue]

from multicam.errors import DataError, ModelError
from multicam.files import require_file
from multicam.image import Letterbox
from multicam.inference.decode import DecodeConfig, RawDetections, decode
from multicam.inference.metadata import NetworkMetadata
from multicam.inference.providers import Chosen, SessionConfig, chosen_providers, require_provider
from multicam.types import Detection, ImageArray

METADATA_KEY = "multicam"
INPUT_NAME = "images"
OUTPUT_NAMES = ("boxes", "scores", "labels", "keypoints", "visibility", "std")

_LOAD_ERRORS = (
    ort_errors.EPFail,
    ort_errors.Fail,
    ort_errors.InvalidArgument,
    ort_errors.InvalidGraph,
    ort_errors.InvalidProtobuf,
    ort_errors.NotImplemented,
    ort_errors.RuntimeException,
)

_NEWER = ("Unsupported model IR version", "released onnx opset versions")
"""What ONNX Runtime says of a file that is newer than itself."""


class Network:
    """A network file, checked and ready to run."""

    def __init__(self, path: Path, config: SessionConfig | None = None) -> None:
        """Opens a network file.

        Raises:
            ModelError: no such file, not ONNX, not ours, of another format version, with inputs or outputs that do
                not fit its metadata, or an execution provider that is not there or cannot run it.
        """
        config = config or SessionConfig()
        self.path = path
        require_provider(config.provider)
        # Judged on the CPU first, so that what a provider objects to is not mistaken for a damaged file.
        self._session = _open(path, config)
        self.metadata = _read_metadata(self._session, path)
        _check_signature(self._session, self.metadata, path)
        if config.provider != "cpu":
            self._session = _start(path, config, chosen_providers(config, self.metadata.precision))
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
    """The file on the CPU."""
    try:
        require_file(path, "network file")
    except DataError as error:
        raise ModelError(str(error)) from error
    try:
        return ort.InferenceSession(str(path), _options(config), providers=["CPUExecutionProvider"])
    except _LOAD_ERRORS as error:
        if any(words in str(error) for words in _NEWER):
            raise ModelError(
                f"{path} needs a newer ONNX Runtime than {ort.__version__}, which is installed; upgrade onnxruntime, "
                "or export the checkpoint again beside this one."
            ) from error
        raise ModelError(
            f"{path} cannot be opened as an ONNX network (is it damaged or cut short?): {_first_line(error)}"
        ) from error


def _start(path: Path, config: SessionConfig, chosen: list[Chosen]) -> ort.InferenceSession:
    """The file on the execution provider that was asked for, and on no other."""
    remedy = 'are its drivers and libraries installed? Choose "cpu" to run without it.'
    try:
        session = ort.InferenceSession(str(path), _options(config), providers=chosen)
    except _LOAD_ERRORS as error:
        raise ModelError(
            f'the execution provider "{config.provider}" cannot run {path} ({_first_line(error)[:-1]}); {remedy}'
        ) from error
    if session.get_providers()[0] != chosen[0][0]:
        raise ModelError(f'the execution provider "{config.provider}" is built in but did not start: {remedy}')
    session.disable_fallback()
    return session


def _options(config: SessionConfig) -> ort.SessionOptions:
    options = ort.SessionOptions()
    options.intra_op_num_threads = config.threads
    # Errors reach the user as exceptions; ONNX Runtime need not print them too.
    options.log_severity_level = 4
    return options


def _read_metadata(session: ort.InferenceSession, path: Path) -> NetworkMetadata:
    text = session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
    if text is None:
        raise ModelError(
            f'{path} is an ONNX file but not one of ours: it lacks the metadata entry "{METADATA_KEY}"; '
            "`multicam export` writes files that have it."
        )
    return NetworkMetadata.from_json(text, str(path))


def _check_signature(session: ort.InferenceSession, metadata: NetworkMetadata, path: Path) -> None:
    """Compares names, types and fixed sizes of inputs and outputs with the metadata.

    The batch must be free, and the count of rows the same in all outputs.
    """
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
    if isinstance(found[INPUT_NAME][1][0], int):
        raise ModelError(
            f"{path} takes batches of {found[INPUT_NAME][1][0]} alone; a network of ours takes as many pictures as "
            "there are cameras. Export the checkpoint again."
        )
    rows = {name: found[name][1][1] for name in OUTPUT_NAMES}
    if len(set(rows.values())) != 1:
        raise ModelError(f"{path} answers with different numbers of rows: {rows}.")
    if len(session.get_inputs()) != 1:
        names = ", ".join(node.name for node in session.get_inputs())
        raise ModelError(f'{path} wants the inputs {names}; a network of ours has the one input "{INPUT_NAME}".')


def _fits(found: tuple[Any, ...], expected: tuple[int | None, ...]) -> bool:
    """Whether shapes agree; a side of None may be anything, dynamic sides (named by ONNX) included."""
    return len(found) == len(expected) and all(e in (None, f) for f, e in zip(found, expected, strict=True))


def _first_line(error: BaseException) -> str:
    return str(error).strip().splitlines()[0].rstrip(".") + "."
