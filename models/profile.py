"""What a network costs without being run: parameters and floating-point operations."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch.utils.flop_counter import FlopCounterMode

from models.config import ModelConfig
from models.detector import Detector, count_parameters


@dataclass(frozen=True)
class Cost:
    """Of the deployed form: normalisations folded, re-parameterised blocks merged.

    Attributes:
        parameters: scalars.
        flops: of one picture, decoding included; a multiplication with its addition counts as two.
    """

    parameters: int
    flops: int


def profile(config: ModelConfig, width: int, height: int, rows: int) -> Cost:
    """Cost of a network for pictures of a size (multiples of 32) and a number of decoded rows.

    Convolutions, products of matrices and attention are counted; what works on single numbers is not. Nothing is
    computed, so the largest network takes no memory.
    """
    with torch.device("meta"):
        detector = Detector(config).fuse()
        images = torch.zeros(1, 3, height, width)
        with torch.inference_mode(), FlopCounterMode(display=False) as counter:
            raw = detector(images)
            detector.decode(raw, min(rows, raw.boxes.shape[1]))
    return Cost(count_parameters(detector), counter.get_total_flops())
