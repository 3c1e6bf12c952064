"""Small charts of a run over time, as SVG."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from multicam.dataset.runs import RunResult
from multicam.evaluation.camera_error import camera_error
from multicam.evaluation.run_error import RunErrors
from multicam.geometry import se3
from multicam.types import FloatArray

STAGE_COLORS = {
    "network": "#3b6fd4",
    "pnp": "#7aa5ee",
    "fit": "#d4a017",
    "follow": "#7c3aed",
    "graph": "#2f9e57",
    "bundle": "#c2410c",
}
LINE_COLORS = ("#3b6fd4", "#c2410c", "#2f9e57", "#7c3aed", "#0f766e", "#be185d")


def error_chart(run: RunResult, errors: RunErrors) -> bytes:
    """Distance (mm) and angle (deg) of each static camera in the headset's frame over time; gaps where unplaced."""
    seconds = _seconds(run)
    figure, axes = new_figure(2, (11, 2.6))
    for index, (name, series) in enumerate(errors.cameras.items()):
        for panel, attribute in zip(axes, ("centre_mm", "rotation_deg"), strict=True):
            values = [np.nan if error is None else getattr(error, attribute) for error in series]
            color = LINE_COLORS[index % len(LINE_COLORS)]
            panel.plot(seconds, values, "-o", markersize=3, linewidth=1.5, color=color, label=name)
    for panel, unit in zip(axes, ("error, mm", "error, deg"), strict=True):
        panel.set_ylabel(unit, fontsize=8.5)
        panel.set_xlabel("s", fontsize=8.5)
        panel.set_ylim(bottom=0)
    axes[0].legend(fontsize=8, frameon=False)
    return to_svg(figure)


def drift_chart(run: RunResult, errors: RunErrors | None) -> bytes:
    """How far the headset's tracking has drifted (mm, deg) over time: as estimated and, where known, in truth.

    The drift is taken where the headset is. With the truth also the error that is left.
    """
    seconds = _seconds(run)
    lines = {"drift, estimated": (_estimated_drift(run), "#3b6fd4", "-")}
    if errors is not None:
        for name, series, color in (
            ("drift, true", errors.tracking, "#1d2430"),
            ("after correction", errors.headset, "#2f9e57"),
        ):
            values = [(np.nan, np.nan) if e is None else (e.centre_mm, e.rotation_deg) for e in series]
            lines[name] = np.array(values), color, "--" if color == "#1d2430" else "-"
    figure, axes = new_figure(2, (11, 2.6))
    for name, (values, color, style) in lines.items():
        for column, panel in enumerate(axes):
            panel.plot(seconds, values[:, column], style, linewidth=1.5, color=color, label=name)
    for panel, unit in zip(axes, ("mm", "deg"), strict=True):
        panel.set_ylabel(unit, fontsize=8.5)
        panel.set_xlabel("s", fontsize=8.5)
        panel.set_ylim(bottom=0)
    axes[0].legend(fontsize=8, frameon=False)
    return to_svg(figure)


def _estimated_drift(run: RunResult) -> FloatArray:
    """(steps, 2) mm and deg between the headset's pose in the world and that by its tracking; nan where unknown."""
    rows: list[tuple[float, float]] = []
    for step in run.steps:
        pose, drift = step.camera(run.headset).world_from_camera, step.world_from_tracking
        if pose is None or drift is None:
            rows.append((np.nan, np.nan))
        else:
            error = camera_error(se3.inverse(drift) @ pose, pose)
            rows.append((error.centre_mm, error.rotation_deg))
    return np.array(rows)


def time_chart(run: RunResult) -> bytes:
    """Stacked milliseconds of each step by stage."""
    figure, (axes,) = new_figure(1, (5.4, 2.6))
    index = np.arange(len(run.steps))
    below = np.zeros(len(run.steps))
    taken = {stage for step in run.steps for stage in step.seconds}
    for stage, color in STAGE_COLORS.items():
        if stage not in taken:
            continue
        values = np.array([1000 * step.seconds.get(stage, 0.0) for step in run.steps])
        axes.bar(index, values, bottom=below, width=0.85, color=color, label=stage)
        below += values
    axes.set_xlabel("step", fontsize=8.5)
    axes.set_ylabel("ms", fontsize=8.5)
    axes.set_ylim(0, 1.35 * max(float(below.max()), 1.0))
    axes.legend(fontsize=8, frameon=False, ncols=5, loc="upper center")
    return to_svg(figure)


def _seconds(run: RunResult) -> list[float]:
    return [(step.timestamp_ns - run.steps[0].timestamp_ns) * 1e-9 for step in run.steps]


def new_figure(columns: int, size: tuple[float, float]) -> tuple[Any, Any]:
    """A figure of the house's style, `size` in inches, and its panels side by side."""
    from matplotlib.figure import Figure

    figure: Any = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(1, columns, squeeze=False)[0]
    for panel in axes:
        panel.tick_params(labelsize=8)
        panel.grid(axis="y", color="#e6e8ec", linewidth=0.6)
        panel.set_axisbelow(True)
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    return figure, axes


def to_svg(figure: Any) -> bytes:
    """The figure as SVG; the same figure gives the same bytes."""
    import matplotlib as mpl

    out = io.BytesIO()
    # Text stays text: smaller files, and the page's own fonts.
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "multicam"}):
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()
