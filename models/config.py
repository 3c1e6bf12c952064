"""What a network is made of: its size and the numbers that follow from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Size = Literal["nano", "tiny", "s", "m", "l", "x"]
NeckName = Literal["pafpn", "hybrid"]

_DEPTH_WIDTH: dict[str, tuple[float, float]] = {
    "nano": (0.33, 0.25),
    "tiny": (0.33, 0.375),
    "s": (0.33, 0.5),
    "m": (0.67, 0.75),
    "l": (1.0, 1.0),
    "x": (1.33, 1.25),
}
"""Depth and width factors of YOLOX (its `exps/default`). Its nano has depthwise convolutions, ours plain ones unless
`depthwise` is set: without published weights they learn more from as many pictures."""


@dataclass(frozen=True)
class ModelConfig:
    """A network, ready to be built; saved beside its weights."""

    num_classes: int
    """Object classes."""
    size: Size = "nano"
    """Depth and width, as YOLOX names them."""
    neck: NeckName = "pafpn"
    """pafpn (YOLOX) or hybrid (the transformer neck of RT-DETR that RTMO uses)."""
    num_keypoints: int = 8
    """Keypoints of every object."""
    strides: tuple[int, ...] = (8, 16, 32)
    """Levels of the head, a run that ends at 32; RTMO uses 16 and 32, small parts need 8."""
    bins: int = 256
    """Bins per axis of the coordinate classifier."""
    depthwise: bool = False
    """Depthwise 3x3 convolutions in the backbone and in YOLOX's neck, as in its published nano."""

    def __post_init__(self) -> None:
        if self.size not in _DEPTH_WIDTH:
            raise ValueError(f'unknown model size "{self.size}"; sizes are {", ".join(_DEPTH_WIDTH)}')
        if self.strides not in ((8, 16, 32), (16, 32)):
            raise ValueError(f"strides must be 8, 16, 32 or 16, 32; got {self.strides}")
        if self.num_classes < 1 or self.num_keypoints < 4 or self.bins < 2:
            raise ValueError("a network needs at least 1 class, 4 keypoints and 2 bins")

    @property
    def depth(self) -> float:
        """Factor on the number of bottlenecks of a CSP block."""
        return _DEPTH_WIDTH[self.size][0]

    @property
    def width(self) -> float:
        """Factor on channels."""
        return _DEPTH_WIDTH[self.size][1]

    @property
    def stem_channels(self) -> int:
        """Channels of the backbone's first layer."""
        return round(64 * self.width)

    @property
    def channels(self) -> tuple[int, int, int]:
        """Channels of the backbone at strides 8, 16, 32."""
        return round(256 * self.width), round(512 * self.width), round(1024 * self.width)

    @property
    def head_channels(self) -> int:
        """Channels of each neck output: one half feeds the classes, the other the pose (RTMO: 256/384/512)."""
        return round(512 * self.width)

    @property
    def pose_channels(self) -> int:
        """Channels inside the pose branch, a multiple of its groups (RTMO: 144/216/288)."""
        return 8 * int(36 * self.width) if self.width >= 0.5 else round(256 * self.width)

    @property
    def pose_groups(self) -> int:
        """Groups of the convolutions inside the pose branch: RTMO's 8; in sizes that RTMO does not have, as many as
        have 16 channels, for with 9 or 13 a processor takes half as long again."""
        return 8 if self.width >= 0.5 else self.pose_channels // 16

    @property
    def pose_vector(self) -> int:
        """Length of the vector from which the coordinate classifier reads all keypoints (RTMO: 256/384/512)."""
        return round(512 * self.width)

    def repeats(self, count: int) -> int:
        """Bottlenecks of a block that has `count` of them at depth 1."""
        return max(round(count * self.depth), 1)
