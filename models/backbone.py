"""CSPDarknet, the backbone of YOLOX (Ge et al. 2021, arXiv 2107.08430)."""

from __future__ import annotations

from torch import Tensor, nn

from models.blocks import ConvBlock, CspBlock, SpatialPyramid, conv3x3
from models.config import ModelConfig


class CspDarknet(nn.Module):
    """Image to features at strides 8, 16 and 32."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        stem, low = config.stem_channels, round(128 * config.width)
        c3, c4, c5 = config.channels

        def stage(inputs: int, outputs: int, repeats: int) -> nn.Sequential:
            return nn.Sequential(
                conv3x3(inputs, outputs, 2, config.depthwise),
                CspBlock(outputs, outputs, config.repeats(repeats), config.depthwise),
            )

        # One 6x6 convolution of stride 2 is YOLOX's space-to-depth followed by a 3x3, as one operation.
        self.stem = ConvBlock(3, stem, 6, 2)
        self.stage4 = stage(stem, low, 3)
        self.stage8 = stage(low, c3, 9)
        self.stage16 = stage(c3, c4, 9)
        self.stage32 = nn.Sequential(
            conv3x3(c4, c5, 2, config.depthwise),
            SpatialPyramid(c5, c5),
            CspBlock(c5, c5, config.repeats(3), config.depthwise, shortcut=False),
        )

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(B, 3, H, W) to features at strides 8, 16, 32; H and W are multiples of 32."""
        at8 = self.stage8(self.stage4(self.stem(images)))
        at16 = self.stage16(at8)
        return at8, at16, self.stage32(at16)
