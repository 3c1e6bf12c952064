"""One self-contained HTML page about a run; it needs no network and no other file."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from multicam import __version__
from multicam.dataset.bop_reader import read_image
from multicam.dataset.runs import CameraResult, RunResult, StepResult
from multicam.dataset.sequence import Recording
from multicam.errors import DataError
from multicam.evaluation.run_error import RunErrors, run_from_true
from multicam.evaluation.single_view_tables import single_view_table
from multicam.evaluation.tables import (
    adjustment_table,
    board_table,
    camera_table,
    coverage_table,
    object_table,
    statements,
    time_table,
)
from multicam.evaluation.truth import Truth
from multicam.files import write_bytes, write_text
from multicam.progress import Progress
from multicam.spread import spread
from multicam.visualization.charts import drift_chart, error_chart, time_chart
from multicam.visualization.overlay import hex_of
from multicam.visualization.pictures import data_uri, encode_jpeg, overlay_path
from multicam.visualization.templating import filled
from multicam.visualization.topview import STATUS_COLORS, TopView, TrueWorld

SHOWN_STEPS = 24
"""The page shows at most this many steps, evenly spread; the overlays of all stand beside it."""

SHOWN_REASONS = 6

SHOWN_WIDTH = 480
"""Pixels of the pictures in the page."""

MEANINGS = {
    "tracked": "its own tracking gives the pose",
    "placed": "what it sees confirms its pose",
    "kept": "pose from an earlier step, not confirmed now",
    "not placed": "no pose",
}


def write_page(
    folder: Path,
    run: RunResult,
    recording: Recording,
    errors: RunErrors | None,
    subtitle: list[str],
    progress: Progress,
) -> Path:
    """Writes report.html and top_view.png into a run's folder, whose overlays must have been drawn.

    Args:
        errors: against the recording's truth, or None before `multicam evaluate`.
        subtitle: lines on where the run came from.

    Returns:
        The page.
    """
    catalogue = recording.catalogue
    truth = None if errors is None else true_world(run, recording)
    top_view = TopView(run, truth)
    shown = spread(range(len(run.steps)), SHOWN_STEPS)
    steps = [
        _shown_step(folder, run, number, top_view) for number in progress.track(shown, "writing the page", len(shown))
    ]
    facts, warnings = statements(run, errors, catalogue)
    seen = sorted({o.obj_id for step in run.steps for o in step.objects})
    tables = {
        "camera_table": camera_table(run, errors) if errors else None,
        "coverage_table": coverage_table(run),
        "time_table": time_table(run),
        "adjustment_table": adjustment_table(errors.adjustment) if errors and errors.adjustment else None,
        "board_table": board_table(errors.board, run.headset) if errors and errors.board else None,
        "object_table": object_table(errors, catalogue) if errors else None,
        "single_view_table": single_view_table(errors.single_view, catalogue) if errors else None,
    }
    page = filled(
        "report.html",
        title="Camera poses from known objects",
        subtitle=subtitle,
        version=__version__,
        facts=facts,
        warnings=warnings,
        judged=errors is not None,
        adjusted=any(step.adjustment is not None for step in run.steps),
        cameras=[c.camera_id for c in run.steps[0].cameras],
        steps=steps,
        objects=[(catalogue[i].name.replace("_", " "), hex_of(i)) for i in seen],
        strips=_strips(run),
        reasons=_reasons(run),
        status_colors=STATUS_COLORS,
        meanings=MEANINGS,
        error_chart=data_uri(error_chart(run, errors), "svg+xml") if errors else None,
        drift_chart=data_uri(drift_chart(run, errors), "svg+xml"),
        time_chart=data_uri(time_chart(run), "svg+xml"),
        **{name: None if table is None else table.to_html() for name, table in tables.items()},
    )
    write_bytes(folder / "top_view.png", top_view.draw(run.steps[-1]))
    write_text(folder / "report.html", page)
    return folder / "report.html"


def true_world(run: RunResult, recording: Recording) -> TrueWorld:
    """The recording's truth in the frame of the run, made to coincide at the headset's first pose.

    Raises:
        DataError: the recording carries no truth.
    """
    truth = Truth(recording)
    change = run_from_true(run, truth)
    if change is None:
        raise DataError(f"the headset {run.headset} has no pose at any step.")
    headsets = (step.camera(run.headset) for step in run.steps)
    trues = [truth.camera(h.camera_id, h.timestamp_ns) for h in headsets if h.timestamp_ns is not None]
    # A camera that was bumped is shown where it ends up.
    statics = {name: change @ truth.static(name, run.steps[-1].timestamp_ns) for name in run.statics}
    return TrueWorld(change @ np.stack(trues), statics)


def _shown_step(folder: Path, run: RunResult, number: int, top_view: TopView) -> dict[str, Any]:
    step = run.steps[number]
    seconds = (step.timestamp_ns - run.steps[0].timestamp_ns) * 1e-9
    return {
        "label": f"step {number + 1} of {len(run.steps)}, {seconds:.1f} s",
        "views": {camera.camera_id: _shown_view(folder, run, step, number, camera) for camera in step.cameras},
        "top": data_uri(top_view.draw(step), "png"),
    }


def _shown_view(folder: Path, run: RunResult, step: StepResult, number: int, camera: CameraResult) -> dict[str, Any]:
    image = None
    if camera.timestamp_ns is not None:
        picture = read_image(overlay_path(folder, camera.camera_id, number))
        scale = min(1.0, SHOWN_WIDTH / picture.shape[1])
        small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        image = data_uri(encode_jpeg(small.astype(np.uint8, copy=False)), "jpeg")
    return {"image": image, "status": camera.status, "detail": _detail(run, step, camera)}


def _detail(run: RunResult, step: StepResult, camera: CameraResult) -> str:
    if camera.status == "kept" and camera.updated_ns is not None:
        age = (step.timestamp_ns - camera.updated_ns) * 1e-9
        return f"from {age:.1f} s ago; {camera.reason}"
    if camera.covariance is not None and camera.camera_id != run.headset:
        return f"{camera.reason + '; ' if camera.reason else ''}uncertain by {_spread_mm(camera):.0f} mm"
    return camera.reason


def _spread_mm(camera: CameraResult) -> float:
    """Largest standard deviation of the camera's position."""
    assert camera.covariance is not None
    return 1000 * float(np.sqrt(np.linalg.eigvalsh(camera.covariance[3:, 3:])[-1]))


def _strips(run: RunResult) -> list[tuple[str, list[tuple[str, str]]]]:
    """Per camera its status at every step with a hint in words."""
    strips: list[tuple[str, list[tuple[str, str]]]] = []
    for name in (c.camera_id for c in run.steps[0].cameras):
        results = [step.camera(name) for step in run.steps]
        cells = [
            (r.status, f"step {i + 1}: {r.status}{', ' + r.reason if r.reason else ''}") for i, r in enumerate(results)
        ]
        strips.append((name, cells))
    return strips


def _reasons(run: RunResult) -> list[tuple[str, int]]:
    """Why cameras were not measured, the numbers in brackets left out, with how often."""
    counts = Counter(
        f"{camera.camera_id}: {re.sub(r' [(].*?[)]', '', camera.reason)}"
        for step in run.steps
        for camera in step.cameras
        if camera.reason
    )
    return counts.most_common(SHOWN_REASONS)
