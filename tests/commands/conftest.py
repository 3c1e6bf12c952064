"""A recording whose pictures carry a mark, and a network file that answers by it with the labelled keypoints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from multicam.dataset.sequence import Recording
from multicam.image import Letterbox
from tests.inference.toy_network import HEIGHT, WIDTH, answer, toy_metadata, write_network
from tests.toy_recording import mark_of, write_toy_recording

ROWS = 6
"""Rows of each answer: five objects at most, and one that is nothing."""


@dataclass(frozen=True)
class Marked:
    """Folder of the recording and file of the network that knows it."""

    recording: Path
    network: Path


@pytest.fixture(scope="session")
def marked(tmp_path_factory: pytest.TempPathFactory) -> Marked:
    folder = tmp_path_factory.mktemp("marked")
    recording = write_toy_recording(folder / "recording", marked=True)
    network = write_network(folder / "toy.onnx", _table(recording), toy_metadata(recording.catalogue).to_json())
    return Marked(folder / "recording", network)


def _table(recording: Recording):
    nothing = answer([0] * ROWS, [0.0] * ROWS, [[0, 0, 1, 1]] * ROWS)
    table = [nothing] * 256
    for camera in recording.cameras:
        for entry in camera.frames:
            row = _answer(recording, camera.camera_id, entry.im_id)
            mark = mark_of(camera.scene_id, entry.im_id)
            table[mark - 5 : mark + 6] = [row] * 11
    return table


def _answer(recording: Recording, camera_id: str, im_id: int):
    record = recording.record(camera_id, im_id)
    letterbox = Letterbox.fit(160, 120, WIDTH, HEIGHT)
    labels, scores = np.zeros(ROWS, dtype=int), np.zeros(ROWS)
    boxes, keypoints = np.zeros((ROWS, 4)), np.zeros((ROWS, 8, 2))
    for i, instance in enumerate(record.instances):
        labels[i], scores[i] = recording.catalogue.obj_ids.index(instance.obj_id), 0.9
        boxes[i] = letterbox.to_input(instance.box.reshape(2, 2)).reshape(4)
        keypoints[i] = letterbox.to_input(instance.keypoints)
    return answer(labels.tolist(), scores.tolist(), boxes.tolist(), keypoints, std=0.03)
