"""TensorBoard: losses, learning rate, validation figures, pictures with predicted keypoints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from multicam.types import ImageArray
from train.samples import TrainedObject
from train.validate import Prediction

PICTURES = 8
"""Validation pictures that are shown."""
_COLOURS = ((255, 60, 60), (60, 220, 60), (70, 130, 255), (255, 200, 40), (220, 90, 255), (60, 220, 220))


class Board:
    """Writes events; a resumed run replaces what it repeats."""

    def __init__(self, folder: Path, step: int) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder), purge_step=step)

    def scalars(self, group: str, values: dict[str, float], step: int) -> None:
        """Adds numbers under group/name."""
        for name, value in values.items():
            self._writer.add_scalar(f"{group}/{name}", value, step)

    def pictures(self, predictions: Sequence[Prediction], objects: Sequence[TrainedObject], step: int) -> None:
        """Adds the first pictures with detections drawn in."""
        drawn = np.stack([draw(p, objects) for p in predictions[:PICTURES]])
        self._writer.add_images("validation/keypoints", drawn, step, dataformats="NHWC")

    def close(self) -> None:
        """Writes what is pending."""
        self._writer.close()


def draw(prediction: Prediction, objects: Sequence[TrainedObject]) -> ImageArray:
    """The picture with boxes and keypoints (visible ones filled) of what was found; true keypoints in white."""
    canvas = prediction.image.copy()
    for keypoints in prediction.labels.keypoints[~prediction.labels.ignored]:
        for x, y in keypoints:
            cv2.circle(canvas, (round(x), round(y)), 1, (255, 255, 255), -1)
    found = prediction.found
    for row, index in enumerate(found.labels):
        colour = _COLOURS[int(index) % len(_COLOURS)]
        x0, y0, x1, y1 = (round(float(v)) for v in found.boxes[row])
        cv2.rectangle(canvas, (x0, y0), (x1, y1), colour, 1)
        text = f"{objects[int(index)].model.name} {found.scores[row]:.2f}"
        cv2.putText(canvas, text, (x0, y0 - 2), cv2.FONT_HERSHEY_SIMPLEX, 0.3, colour, 1, cv2.LINE_AA)
        for (x, y), visible in zip(found.keypoints[row], found.visibility[row], strict=True):
            cv2.circle(canvas, (round(float(x)), round(float(y))), 2, colour, -1 if visible > 0.5 else 1)
    return canvas
