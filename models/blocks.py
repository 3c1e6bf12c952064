"""Convolution blocks of YOLOX and RT-DETR; batch normalisation with YOLOX's constants."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval


class ConvBlock(nn.Module):
    """Convolution, batch normalisation, activation."""

    def __init__(
        self, inputs: int, outputs: int, kernel: int, stride: int = 1, groups: int = 1, activate: bool = True
    ) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, kernel, stride, padding=(kernel - 1) // 2, groups=groups, bias=False)
        self.norm: nn.Module = nn.BatchNorm2d(outputs, eps=1e-3, momentum=0.03)
        self.activation = nn.SiLU(inplace=True) if activate else nn.Identity()

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, outputs, H/stride, W/stride)."""
        return self.activation(self.norm(self.conv(x)))

    def fold(self) -> None:
        """Folds the normalisation into the convolution; evaluation mode only."""
        if isinstance(self.norm, nn.BatchNorm2d):
            self.conv = fuse_conv_bn_eval(self.conv, self.norm)
            self.norm = nn.Identity()


class DepthwiseBlock(nn.Module):
    """3x3 within each channel, then 1x1 across them, both normalised and activated (YOLOX's nano)."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.within = ConvBlock(inputs, inputs, 3, stride, groups=inputs)
        self.across = ConvBlock(inputs, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, outputs, H/stride, W/stride)."""
        return self.across(self.within(x))


def conv3x3(inputs: int, outputs: int, stride: int, depthwise: bool) -> ConvBlock | DepthwiseBlock:
    """A 3x3, plain or depthwise."""
    return DepthwiseBlock(inputs, outputs, stride) if depthwise else ConvBlock(inputs, outputs, 3, stride)


class Bottleneck(nn.Module):
    """1x1 then 3x3, with a shortcut on request."""

    def __init__(self, channels: int, shortcut: bool, depthwise: bool) -> None:
        super().__init__()
        self.layers = nn.Sequential(ConvBlock(channels, channels, 1), conv3x3(channels, channels, 1, depthwise))
        self.shortcut = shortcut

    def forward(self, x: Tensor) -> Tensor:
        """Same shape."""
        return self.layers(x) + x if self.shortcut else self.layers(x)


class CspBlock(nn.Module):
    """Cross-stage partial block: half of the channels go through bottlenecks, half go past them."""

    def __init__(self, inputs: int, outputs: int, repeats: int, depthwise: bool, shortcut: bool = True) -> None:
        super().__init__()
        hidden = outputs // 2
        self.main = ConvBlock(inputs, hidden, 1)
        self.side = ConvBlock(inputs, hidden, 1)
        self.bottlenecks = nn.Sequential(*(Bottleneck(hidden, shortcut, depthwise) for _ in range(repeats)))
        self.merge = ConvBlock(2 * hidden, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, outputs, H, W)."""
        # Both first, as YOLOX does: by this order the convolutions of a published file are told apart.
        main, side = self.main(x), self.side(x)
        return self.merge(torch.cat((self.bottlenecks(main), side), dim=1))


class SpatialPyramid(nn.Module):
    """Max pools of 5, 9 and 13 pixels side by side; three pools of 5 in a row give the same."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.reduce = ConvBlock(inputs, inputs // 2, 1)
        self.pool = nn.MaxPool2d(5, stride=1, padding=2)
        self.merge = ConvBlock(inputs * 2, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, outputs, H, W)."""
        x = self.reduce(x)
        five = self.pool(x)
        nine = self.pool(five)
        return self.merge(torch.cat((x, five, nine, self.pool(nine)), dim=1))


class RepBlock(nn.Module):
    """3x3 beside 1x1, summed, then SiLU; `fold` turns both into one 3x3 (RepVGG)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.wide = ConvBlock(channels, channels, 3, activate=False)
        self.narrow: ConvBlock | None = ConvBlock(channels, channels, 1, activate=False)
        self.activation = nn.SiLU(inplace=True)

    def forward(self, x: Tensor) -> Tensor:
        """Same shape."""
        out = self.wide(x)
        return self.activation(out if self.narrow is None else out + self.narrow(x))

    def fold(self) -> None:
        """Adds the 1x1 to the centre of the 3x3; evaluation mode only."""
        if self.narrow is None:
            return
        self.wide.fold()
        self.narrow.fold()
        wide, narrow = self.wide.conv, self.narrow.conv
        assert wide.bias is not None and narrow.bias is not None
        with torch.no_grad():
            wide.weight[:, :, 1, 1] += narrow.weight[:, :, 0, 0]
            wide.bias += narrow.bias
        self.narrow = None
