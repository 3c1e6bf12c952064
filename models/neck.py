"""Necks: mix the three backbone levels and hand each level of the head the same number of channels."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import ConvBlock, CspBlock, RepBlock, conv3x3
from models.config import ModelConfig


def build_neck(config: ModelConfig) -> nn.Module:
    """The neck that the configuration names."""
    return Pafpn(config) if config.neck == "pafpn" else HybridEncoder(config)


class Pafpn(nn.Module):
    """Path aggregation network of YOLOX: top-down, then bottom-up; a 1x1 projector follows as in RTMO."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        c3, c4, c5 = config.channels

        def csp(inputs: int, outputs: int) -> CspBlock:
            return CspBlock(inputs, outputs, config.repeats(3), config.depthwise, shortcut=False)

        self.lateral5 = ConvBlock(c5, c4, 1)
        self.down4 = csp(2 * c4, c4)
        self.lateral4 = ConvBlock(c4, c3, 1)
        self.down3 = csp(2 * c3, c3)
        self.reduce3 = conv3x3(c3, c3, 2, config.depthwise)
        self.up4 = csp(2 * c3, c4)
        self.reduce4 = conv3x3(c4, c4, 2, config.depthwise)
        self.up5 = csp(2 * c4, c5)
        self.levels = len(config.strides)
        self.projectors = _projectors((c3, c4, c5)[-self.levels :], config.head_channels)

    def forward(self, features: tuple[Tensor, Tensor, Tensor]) -> list[Tensor]:
        """Features at strides 8, 16, 32 to (B, head_channels, H/s, W/s) for each stride s of the head."""
        at8, at16, at32 = features
        top = self.lateral5(at32)
        mid = self.lateral4(self.down4(torch.cat((_upsample(top), at16), dim=1)))
        out8 = self.down3(torch.cat((_upsample(mid), at8), dim=1))
        out16 = self.up4(torch.cat((self.reduce3(out8), mid), dim=1))
        out32 = self.up5(torch.cat((self.reduce4(out16), top), dim=1))
        outputs = (out8, out16, out32)[-self.levels :]
        return [project(x) for project, x in zip(self.projectors, outputs, strict=True)]


class HybridEncoder(nn.Module):
    """Neck of RT-DETR (Zhao et al. 2023, arXiv 2304.08069): self-attention at stride 32, then CSP fusion."""

    def __init__(self, config: ModelConfig, channels: int = 256) -> None:
        super().__init__()
        self.inputs = nn.ModuleList(ConvBlock(c, channels, 1, activate=False) for c in config.channels)
        self.attention = EncoderLayer(channels, heads=8, hidden=1024)
        self.laterals = nn.ModuleList(ConvBlock(channels, channels, 1) for _ in range(2))
        self.reducers = nn.ModuleList(ConvBlock(channels, channels, 3, 2) for _ in range(2))
        self.down = nn.ModuleList(CspRep(channels, config) for _ in range(2))
        self.up = nn.ModuleList(CspRep(channels, config) for _ in range(2))
        self.levels = len(config.strides)
        self.projectors = _projectors((channels,) * self.levels, config.head_channels)

    def forward(self, features: tuple[Tensor, Tensor, Tensor]) -> list[Tensor]:
        """Features at strides 8, 16, 32 to (B, head_channels, H/s, W/s) for each stride s of the head."""
        at8, at16, at32 = (project(x) for project, x in zip(self.inputs, features, strict=True))
        top = self.laterals[0](self.attention(at32))
        mid = self.laterals[1](self.down[0](torch.cat((_upsample(top), at16), dim=1)))
        out8 = self.down[1](torch.cat((_upsample(mid), at8), dim=1))
        out16 = self.up[0](torch.cat((self.reducers[0](out8), mid), dim=1))
        out32 = self.up[1](torch.cat((self.reducers[1](out16), top), dim=1))
        outputs = (out8, out16, out32)[-self.levels :]
        return [project(x) for project, x in zip(self.projectors, outputs, strict=True)]


class CspRep(nn.Module):
    """Two 1x1 branches, one of them followed by re-parameterisable blocks, summed."""

    def __init__(self, channels: int, config: ModelConfig) -> None:
        super().__init__()
        hidden = 8 * round(channels * config.width / 8)
        self.main = nn.Sequential(
            ConvBlock(2 * channels, hidden, 1), *(RepBlock(hidden) for _ in range(config.repeats(3)))
        )
        self.side = ConvBlock(2 * channels, hidden, 1)
        self.merge = ConvBlock(hidden, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """(B, 2 channels, H, W) to (B, channels, H, W)."""
        return self.merge(self.main(x) + self.side(x))


class EncoderLayer(nn.Module):
    """One transformer encoder layer over the cells of a map; normalisation after each residual."""

    def __init__(self, channels: int, heads: int, hidden: int) -> None:
        super().__init__()
        self.heads = heads
        self.query_key = nn.Linear(channels, 2 * channels)
        self.value = nn.Linear(channels, channels)
        self.out = nn.Linear(channels, channels)
        self.feed = nn.Sequential(nn.Linear(channels, hidden), nn.GELU(), nn.Linear(hidden, channels))
        self.norm1, self.norm2 = nn.LayerNorm(channels), nn.LayerNorm(channels)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W), same shape."""
        batch, channels, height, width = x.shape
        tokens = x.flatten(2).transpose(1, 2)
        place = sine_encoding(height, width, channels, x.device).to(x.dtype)
        query, key = self._split(self.query_key(tokens + place), 2)
        (value,) = self._split(self.value(tokens), 1)
        mixed = F.scaled_dot_product_attention(query, key, value).transpose(1, 2).reshape(tokens.shape)
        tokens = self.norm1(tokens + self.out(mixed))
        tokens = self.norm2(tokens + self.feed(tokens))
        return tokens.transpose(1, 2).reshape(batch, channels, height, width)

    def _split(self, x: Tensor, parts: int) -> Sequence[Tensor]:
        """(B, N, parts C) to `parts` tensors (B, heads, N, C / heads)."""
        batch, count, channels = x.shape
        heads = x.reshape(batch, count, parts, self.heads, channels // parts // self.heads)
        return heads.permute(2, 0, 3, 1, 4).unbind(0)


def sine_encoding(height: int, width: int, channels: int, device: torch.device) -> Tensor:
    """(H W, channels) two-dimensional sine encoding with temperature 10 000; rows go along x first."""
    quarter = channels // 4
    frequency = 10000.0 ** -(torch.arange(quarter, device=device) / quarter)
    x = torch.arange(width, device=device)[:, None] * frequency
    y = torch.arange(height, device=device)[:, None] * frequency
    along_x = torch.cat((x.sin(), x.cos()), dim=1)[None].expand(height, -1, -1)
    along_y = torch.cat((y.sin(), y.cos()), dim=1)[:, None].expand(-1, width, -1)
    return torch.cat((along_x, along_y), dim=2).flatten(0, 1)


def _projectors(inputs: Sequence[int], outputs: int) -> nn.ModuleList:
    return nn.ModuleList(ConvBlock(c, outputs, 1, activate=False) for c in inputs)


def _upsample(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2, mode="nearest")
