"""Small charts of what a data set holds, as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from datagen.sheets.labels import Split
from multicam.types import FloatArray
from multicam.visualization.charts import LINE_COLORS, new_figure, to_svg


def class_chart(counts: dict[str, dict[str, tuple[int, int]]]) -> bytes:
    """Labelled objects per class and split: pale all, full those at least a tenth visible."""
    names = list(next(iter(counts.values())))
    figure, (panel,) = new_figure(1, (11, 0.6 + 0.22 * len(names) * len(counts)))
    height = 0.8 / len(counts)
    for index, (split, rows) in enumerate(counts.items()):
        places = np.arange(len(names)) + (index - (len(counts) - 1) / 2) * height
        color = LINE_COLORS[index % len(LINE_COLORS)]
        panel.barh(places, [rows[n][0] for n in names], height * 0.9, color=color, alpha=0.35)
        panel.barh(places, [rows[n][1] for n in names], height * 0.9, color=color, label=split)
    panel.set_yticks(np.arange(len(names)), [name.replace("_", " ") for name in names])
    panel.invert_yaxis()
    panel.grid(axis="x", color="#e6e8ec", linewidth=0.6)
    panel.grid(visible=False, axis="y")
    panel.set_xlabel("labelled objects (full colour: at least a tenth visible)", fontsize=8.5)
    _legend(panel, len(counts))
    return to_svg(figure)


def distribution_chart(splits: Sequence[Split]) -> bytes:
    """Distance, visible fraction and size of box of all labelled objects, as shares per split."""
    figure, panels = new_figure(3, (11, 2.5))
    for index, split in enumerate(splits):
        rows = split.instances
        values = (
            np.array([np.linalg.norm(r.camera_from_object[:3, 3]) for r in rows]),
            np.array([r.visible_fraction for r in rows if r.visible_fraction is not None]),
            np.array([np.sqrt(np.prod(r.box[2:] - r.box[:2])) for r in rows if r.box is not None]),
        )
        for panel, numbers, limit in zip(panels, values, (None, 1.0, None), strict=True):
            _histogram(panel, numbers, limit, LINE_COLORS[index % len(LINE_COLORS)], split.name)
    for panel, label in zip(panels, ("distance, m", "visible fraction", "box, px (root of its area)"), strict=True):
        panel.set_xlabel(label, fontsize=8.5)
        panel.set_ylabel("% of objects", fontsize=8.5)
        panel.set_xlim(left=0)
    _legend(panels[0], len(splits))
    return to_svg(figure)


def _histogram(panel: Any, values: FloatArray, limit: float | None, color: str, label: str) -> None:
    if len(values) == 0:
        return
    # A few boxes of objects at the border are huge; the axis is for the rest.
    top = limit if limit is not None else 1.05 * float(np.quantile(values, 0.995))
    edges = np.linspace(0, max(top, 1e-9), 31)
    shares, _ = np.histogram(np.minimum(values, top), edges)
    panel.stairs(100 * shares / len(values), edges, color=color, linewidth=1.5, label=label)


def _legend(panel: Any, count: int) -> None:
    if count > 1:
        panel.legend(fontsize=8, frameon=False)
