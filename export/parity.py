"""PyTorch against ONNX Runtime, number by number, on the file that will be shipped.

Both sort cells by score, and scores that differ only by rounding may change places. So each row that ONNX Runtime
answers is led back to its cell, and compared with what PyTorch computes for that very cell; the choice of cells is
compared by its sorted scores.

Single precision bounds what can agree: a keypoint that spreads over many pixels moves with the rounding of its logits
in proportion to that spread, and a box with its size. Such outputs are compared in units that grow with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from export.wrapper import DeployDetector
from models.detector import Decoded, RawOutputs
from multicam.errors import ModelError
from multicam.image import Letterbox
from multicam.inference.session import Network
from multicam.types import ImageArray

BATCHES = (1, 3, 8, 32)

PROBABILITY_TOLERANCE = 1e-4
"""For scores and visibilities."""


@dataclass(frozen=True)
class Parity:
    """Greatest differences over everything compared; pixels for boxes, keypoints and std, else probabilities.

    Attributes:
        choice: of the sorted scores, which tells whether the same cells were chosen.
        boxes: pixels, divided by a hundredth of the box's longer side where that exceeds 1.
        keypoints, std: pixels, divided by the keypoint's own std where that exceeds 1.
        labels: by which the class answered scores less than the best class of its cell.
    """

    choice: float
    boxes: float
    scores: float
    labels: float
    keypoints: float
    visibility: float
    std: float

    def require(self, tolerance_px: float) -> None:
        """Accepts the differences.

        Raises:
            ModelError: one is greater than its tolerance, or is not a number.
        """
        for item in fields(self):
            in_pixels = item.name in ("boxes", "keypoints", "std")
            tolerance = tolerance_px if in_pixels else PROBABILITY_TOLERANCE
            found = getattr(self, item.name)
            # Not "found > tolerance": NaN must fail.
            if not found <= tolerance:
                raise ModelError(
                    f"ONNX Runtime and PyTorch differ in {item.name} by {found:.2g}{' px' if in_pixels else ''}, more "
                    f"than the tolerated {tolerance:.2g}; no file was written."
                )


def compare(detector: DeployDetector, network: Network, images: Sequence[ImageArray]) -> Parity:
    """Runs both on batches of 1, 3, 8 and 32 pictures: given ones, and invented ones.

    The greatest batch holds them all; the others take pictures from both ends, given ones at the front.

    Args:
        images: (h, w, 3) uint8 RGB of any sizes, fewer than the greatest batch; may be empty.
    """
    width, height = network.metadata.width, network.metadata.height
    rng = np.random.default_rng(0)
    inputs = [Letterbox.fit(image.shape[1], image.shape[0], width, height).apply(image) for image in images]
    assert len(inputs) < BATCHES[-1]
    inputs += [_invented(rng, width, height) for _ in range(BATCHES[-1] - len(inputs))]
    batches = [part for size in BATCHES[:-1] for part in (inputs[:size], inputs[-size:])] + [inputs]
    worst = [_compare_batch(detector, network, np.stack(batch)) for batch in batches]
    return Parity(*np.max(worst, axis=0).tolist())


def _invented(rng: np.random.Generator, width: int, height: int) -> ImageArray:
    """Smooth blobs of colour with fine noise: a network answers them in more varied ways than plain noise."""
    coarse = rng.uniform(0, 255, (height // 32 + 1, width // 32 + 1, 3)).astype(np.float32)
    smooth = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(smooth + rng.normal(scale=12, size=smooth.shape), 0, 255).astype(np.uint8)


@torch.inference_mode()
def _compare_batch(detector: DeployDetector, network: Network, batch: ImageArray) -> NDArray[np.float64]:
    """Greatest difference of each field of `Parity`."""
    raw = detector.raw(torch.from_numpy(batch))
    answers = Decoded(*(torch.from_numpy(output) for output in network.run(batch)))
    per_image = [
        _compare_image(detector, raw, Decoded(*(output[i] for output in answers)), i) for i in range(len(batch))
    ]
    return torch.stack(per_image).amax(dim=0).double().numpy()


def _compare_image(detector: DeployDetector, raw: RawOutputs, answer: Decoded, index: int) -> Tensor:
    boxes, classes = raw.boxes[index], raw.class_logits[index].sigmoid()
    visibility = raw.visibility_logits[index].sigmoid()
    told_by = torch.cat((answer.boxes, answer.visibility), dim=1), torch.cat((boxes, visibility), dim=1)
    cells = torch.cdist(*told_by, p=1).argmin(dim=1)
    expected = detector.detector.dcc(raw.pose_vectors[index][cells], boxes[cells], raw.centres[cells])
    best = classes.amax(dim=1)
    choice = (best.topk(len(cells)).values - answer.scores).abs()
    if len(cells.unique()) < len(cells):
        # One cell answered twice means that another was left out, whatever the scores say.
        choice = torch.ones_like(choice)
    answered = classes[cells].gather(1, answer.labels[:, None])[:, 0]
    sides = (boxes[cells, 2:] - boxes[cells, :2]).amax(dim=1, keepdim=True)
    box_unit, keypoint_unit = (sides / 100).clamp(min=1), expected.std.clamp(min=1)
    differences = (
        choice,
        (answer.boxes - boxes[cells]) / box_unit,
        answer.scores - best[cells],
        answered - best[cells],
        (answer.keypoints - expected.keypoints) / keypoint_unit,
        answer.visibility - visibility[cells],
        (answer.std - expected.std) / keypoint_unit,
    )
    return torch.stack([difference.abs().max() for difference in differences])
