"""The detector as it is deployed: bytes in, the best rows with keypoints and uncertainties out."""

from __future__ import annotations

from torch import Tensor, nn

from models.detector import Decoded, Detector, RawOutputs


class DeployDetector(nn.Module):
    """Pictures to the `count` best cells of each; no shape depends on what the pictures show."""

    def __init__(self, detector: Detector, count: int) -> None:
        super().__init__()
        self.detector = detector.fuse()
        self.count = count
        self.eval()

    def forward(self, images: Tensor) -> Decoded:
        """Letterboxed pictures (B, H, W, 3) uint8 RGB, H and W multiples of 32, to rows sorted by score.

        Standard deviations are in pixels and join both cues: the larger of the heat map's own deviation and of the
        learned Laplace scale's, 2 sqrt(2) sigma sqrt(A) (see `models.dcc`).
        """
        return self.detector.decode(self.raw(images), self.count)

    def raw(self, images: Tensor) -> RawOutputs:
        """All cells of the same pictures."""
        return self.detector(images.permute(0, 3, 1, 2).float())
