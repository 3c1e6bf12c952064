"""A drawing over a picture, as SVG markup: sharp at any size, and its text can be searched."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

import numpy as np

from multicam.types import FloatArray, ImageArray
from multicam.visualization.pictures import data_uri, encode_jpeg

_HALO = 'stroke="white" stroke-width="3" stroke-linejoin="round" paint-order="stroke"'


class Drawing:
    """Collects shapes; coordinates are pixels of the drawing, y down."""

    def __init__(self, width: float, height: float, title: str) -> None:
        self._parts = [
            f'<svg viewBox="0 0 {width:g} {height:g}" role="img" xmlns="http://www.w3.org/2000/svg">'
            f"<title>{html.escape(title)}</title>"
        ]

    def picture(self, image: ImageArray, width: float, height: float) -> None:
        """An RGB picture that fills the rectangle from the origin."""
        source = data_uri(encode_jpeg(image), "jpeg")
        self._parts.append(f'<image href="{source}" width="{width:g}" height="{height:g}"/>')

    def line(self, a: FloatArray, b: FloatArray, color: str, width: float = 1.0, dash: str = "") -> None:
        """A straight line."""
        (x1, y1), (x2, y2) = a, b
        dashed = f' stroke-dasharray="{dash}"' if dash else ""
        self._parts.append(
            f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{color}" '
            f'stroke-width="{width:g}"{dashed}/>'
        )

    def arrow(self, a: FloatArray, b: FloatArray, color: str, width: float = 1.0, both: bool = False) -> None:
        """A line with a head at its end, or at both."""
        self.line(a, b, color, width)
        for tip, tail in ((b, a), (a, b))[: 2 if both else 1]:
            along = (tip - tail) / max(float(np.linalg.norm(tip - tail)), 1e-9)
            side = np.array([-along[1], along[0]])
            size = 3 + 2 * width
            self.polygon(
                [tip, tip - size * along + size / 2.6 * side, tip - size * along - size / 2.6 * side], color, color
            )

    def polygon(self, points: Sequence[FloatArray] | FloatArray, stroke: str, fill: str, width: float = 0.0) -> None:
        """A closed polygon."""
        listed = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        self._parts.append(f'<polygon points="{listed}" stroke="{stroke}" fill="{fill}" stroke-width="{width:g}"/>')

    def outline(self, contours: Iterable[FloatArray], color: str, width: float) -> None:
        """Closed outlines, dark below so that they stand out on any ground."""
        path = " ".join("M" + "L".join(f"{x:.0f} {y:.0f}" for x, y in contour) + "Z" for contour in contours)
        for stroke, size in (("#000", width + 1.2), (color, width)):
            self._parts.append(f'<path d="{path}" fill="none" stroke="{stroke}" stroke-width="{size:g}"/>')

    def rectangle(self, box: FloatArray, color: str, width: float, dash: str = "") -> None:
        """A box x0 y0 x1 y1."""
        x0, y0, x1, y1 = box
        dashed = f' stroke-dasharray="{dash}"' if dash else ""
        self._parts.append(
            f'<rect x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0:.1f}" height="{y1 - y0:.1f}" fill="none" '
            f'stroke="{color}" stroke-width="{width:g}"{dashed}/>'
        )

    def dot(self, at: FloatArray, radius: float, fill: str, stroke: str) -> None:
        """A disc with a rim."""
        self._parts.append(
            f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{radius:g}" fill="{fill}" stroke="{stroke}"/>'
        )

    def text(
        self, at: FloatArray, words: str, size: float = 12, color: str = "#1d2430", anchor: str = "start",
        bold: bool = False, turned: bool = False,
    ) -> None:  # fmt: skip
        """Words with a white rim, their base line's start, middle or end at a point; turned ones read upwards."""
        weight = ' font-weight="600"' if bold else ""
        turn = f' transform="rotate(-90 {at[0]:.1f} {at[1]:.1f})"' if turned else ""
        self._parts.append(
            f'<text x="{at[0]:.1f}" y="{at[1]:.1f}" font-size="{size:g}" fill="{color}" text-anchor="{anchor}"'
            f"{weight}{turn} {_HALO}>{html.escape(words)}</text>"
        )

    def markup(self) -> str:
        """The whole drawing."""
        return "".join(self._parts) + "</svg>"
