"""Charts of the errors of a split, as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.evaluation.calibration import LEVELS, KeypointErrors, keypoint_shares, pose_shares
from multicam.evaluation.report import Table
from multicam.evaluation.single_view import ObjectErrors
from multicam.evaluation.single_view_tables import TENTH, Errors
from multicam.types import FloatArray
from multicam.visualization.charts import LINE_COLORS, new_figure, to_svg
from multicam.visualization.overlay import hex_of

_INK, _SOFT = "#1d2430", "#8a93a2"
_BINS = 12
"""Groups of equal size in which stated and true errors of keypoints are compared."""
_MARKS = [digit * 10.0**power for power in range(-3, 5) for digit in (1, 2, 5)]


def accuracy_chart(errors: Errors, catalogue: Catalogue) -> bytes:
    """Share of objects whose ADD(-S) is below a threshold, per class and on average: in mm, and by the diameter."""
    figure, panels = new_figure(2, (11, 3.4))
    scales = {obj_id: (1000.0, 1 / catalogue[obj_id].diameter) for obj_id in errors}
    for column, (panel, limit) in enumerate(zip(panels, (100.0, 0.5), strict=True)):
        thresholds = np.linspace(0, limit, 201)
        curves: list[FloatArray] = []
        for obj_id, found in errors.items():
            values = np.array([e.add_or_add_s for e in found]) * scales[obj_id][column]
            curves.append(100 * np.mean(values[:, None] < thresholds, axis=0))
            panel.plot(thresholds, curves[-1], color=hex_of(obj_id), linewidth=1.1, label=catalogue[obj_id].name)
        panel.plot(thresholds, np.mean(curves, axis=0), color=_INK, linewidth=2.2, label="mean of classes")
        panel.set_xlim(0, limit)
        panel.set_ylim(0, 102)
    panels[1].axvline(TENTH, color=_SOFT, linewidth=1, linestyle="--")
    for panel, label in zip(panels, ("ADD(-S), mm", "ADD(-S) / diameter (dashed: a tenth)"), strict=True):
        panel.set_xlabel(label, fontsize=8.5)
        panel.set_ylabel("% of objects below", fontsize=8.5)
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, fontsize=7.5, frameon=False, loc="outside right center", ncols=1 + len(names) // 16)
    return to_svg(figure)


def bins_chart(tables: Sequence[Table]) -> bytes:
    """Bars for each bin of one or two tables: found, within a tenth of the diameter, AUC."""
    figure, panels = new_figure(2, (11, 2.7))
    panels[1].set_visible(len(tables) > 1)
    series = {"found %": "#c3cad5", "within 0.1 d %": LINE_COLORS[0], "AUC %": LINE_COLORS[2]}
    for panel, table in zip(panels, tables, strict=False):
        rows = table.to_plain()["rows"]
        first = table.columns[0].name
        places = np.arange(len(rows))
        for index, (name, color) in enumerate(series.items()):
            heights = [row[name] or 0.0 for row in rows]
            panel.bar(places + 0.27 * (index - 1), heights, 0.25, color=color, label=name.removesuffix(" %"))
        panel.set_xticks(places, [f"{row[first]}\n{row['asked']} objects" for row in rows])
        panel.set_ylim(0, 118)
        panel.set_yticks(range(0, 101, 20))
        panel.set_ylabel("%", fontsize=8.5)
        panel.set_title(table.title, fontsize=9.5, loc="left", color=_INK)
    panels[0].legend(fontsize=8, frameon=False, ncols=3, loc="upper left")
    return to_svg(figure)


def calibration_chart(
    keypoints: Sequence[KeypointErrors], poses: Sequence[ObjectErrors], catalogue: Catalogue
) -> bytes:
    """Stated against true uncertainty: shares inside at each level, and errors of keypoints by what was stated.

    Args:
        poses: those with a covariance.
    """
    figure, panels = new_figure(2, (11, 3.4))
    _reliability(panels[0], keypoints, poses, catalogue)
    _spread(panels[1], keypoints)
    return to_svg(figure)


def _reliability(
    panel: Any, keypoints: Sequence[KeypointErrors], poses: Sequence[ObjectErrors], catalogue: Catalogue
) -> None:
    panel.plot([0, 100], [0, 100], color=_SOFT, linewidth=1, linestyle="--", label="honest")
    if keypoints:
        shares = 100 * keypoint_shares(keypoints, LEVELS)
        panel.plot(100 * LEVELS, shares, "-o", markersize=3, color=LINE_COLORS[0], label="keypoint coordinates")
    if poses:
        shares = 100 * pose_shares(poses, catalogue, LEVELS)
        panel.plot(100 * LEVELS, shares, "-o", markersize=3, color=LINE_COLORS[1], label="poses")
    panel.set_xlim(0, 100)
    panel.set_ylim(0, 100)
    panel.set_xlabel("% that should lie inside", fontsize=8.5)
    panel.set_ylabel("% that lie inside", fontsize=8.5)
    panel.legend(fontsize=8, frameon=False)


def _spread(panel: Any, keypoints: Sequence[KeypointErrors]) -> None:
    """Of keypoint coordinates in groups by stated deviation: what 68 % of the errors stay below."""
    panel.set_xlabel("stated standard deviation, px", fontsize=8.5)
    panel.set_ylabel("68 % of errors below, px", fontsize=8.5)
    if not keypoints:
        return
    stated = np.concatenate([e.std.ravel() for e in keypoints])
    errors = np.abs(np.concatenate([e.errors.ravel() for e in keypoints]))
    groups = [group for group in np.array_split(np.argsort(stated), _BINS) if len(group)]
    x = np.array([np.median(stated[group]) for group in groups])
    y = np.array([np.quantile(errors[group], 0.683) for group in groups])
    panel.loglog(x, y, "-o", markersize=3.5, color=LINE_COLORS[0])
    low, high = min(x.min(), y.min()), max(x.max(), y.max())
    panel.loglog([low, high], [low, high], color=_SOFT, linewidth=1, linestyle="--")
    marks = [m for m in _MARKS if low / 2 < m < 2 * high]
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_ticks(marks, [f"{mark:g}" for mark in marks])
        axis.set_ticks([], minor=True)
