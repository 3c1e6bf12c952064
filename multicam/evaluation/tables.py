"""Errors of a run as tables, and as plain sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.dataset.runs import RunResult
from multicam.evaluation.board_error import BoardErrors
from multicam.evaluation.camera_error import CameraError
from multicam.evaluation.recall import auc_posecnn, median, recall
from multicam.evaluation.report import Cell, Column, Table, mean_cell
from multicam.evaluation.run_error import AdjustmentErrors, RunErrors
from multicam.evaluation.single_view_tables import TENTH, tenth_recall
from multicam.types import FloatArray

GOOD_MM, GOOD_DEG = 50.0, 5.0
"""A camera pose within both counts as good."""


def camera_table(run: RunResult, errors: RunErrors) -> Table:
    """One row per static camera and per pair of them, and two for the headset; errors where there was a pose."""
    rows = [_camera_row(f"{name} in {run.headset}", found) for name, found in errors.cameras.items()]
    rows += [_camera_row(f"{b} in {a}", found) for (a, b), found in errors.pairs.items()]
    rows.append(_camera_row(f"{run.headset} since its first pose", errors.headset))
    rows.append(_camera_row(f"{run.headset} by its tracking alone", errors.tracking))
    columns = ("camera", "has pose %", "good %", "median mm", "median deg", "p90 mm", "p90 deg", "last mm", "last deg")
    decimals = (0, 0, 0, 1, 2, 1, 2, 1, 2)
    return Table(
        "Camera errors",
        (*(Column(name, d) for name, d in zip(columns, decimals, strict=True)), Column("inside 95 %", 0)),
        tuple(rows),
        f"Angle and distance of centres against truth, in the frame of the second camera. good: within {GOOD_MM:g} mm "
        f"and {GOOD_DEG:g} deg, of all steps. inside 95 %: steps whose truth lies in the stated ellipsoid.",
    )


def coverage_table(run: RunResult) -> Table:
    """One row per camera: how its pose was known over the steps."""
    rows: list[tuple[Cell, ...]] = []
    count = len(run.steps)
    for name in (run.headset, *run.statics):
        results = [step.camera(name) for step in run.steps]
        known = [r.status != "not placed" for r in results]
        measured = sum(r.status in ("tracked", "placed") for r in results)
        first = run.steps[known.index(True)].timestamp_ns if any(known) else None
        since = None if first is None else (first - run.steps[0].timestamp_ns) * 1e-9
        rows.append((name, 100 * sum(known) / count, measured, sum(known) - measured, count - sum(known), since))
    names = ("camera", "has pose %", "measured", "kept", "not placed", "first pose s")
    return Table(
        "Coverage", tuple(Column(n, 1 if n.endswith(" s") else 0) for n in names), tuple(rows), "Counts are steps."
    )


def time_table(run: RunResult) -> Table:
    """Milliseconds per step by stage."""
    stages = dict.fromkeys(stage for step in run.steps for stage in step.seconds)
    times = {stage: [1000 * step.seconds.get(stage, 0.0) for step in run.steps] for stage in stages}
    times["all"] = [1000 * sum(step.seconds.values()) for step in run.steps]
    rows = tuple(
        (stage, float(np.mean(values)), float(np.median(values)), float(np.percentile(values, 90)))
        for stage, values in times.items()
    )
    note = "All cameras of a step together; reading pictures from disk not included."
    return Table("Time per step", tuple(map(Column, ("stage", "mean ms", "median ms", "p90 ms"))), rows, note)


def adjustment_table(errors: AdjustmentErrors) -> Table:
    """One row per static camera that was adjusted and one for all objects: medians before and after."""
    rows: list[tuple[Cell, ...]] = []
    for name, pairs in errors.cameras.items():
        if pairs:
            mm = np.array([[error.centre_mm for error in pair] for pair in pairs])
            deg = np.array([[error.rotation_deg for error in pair] for pair in pairs])
            rows.append((name, len(pairs), *np.median(mm, axis=0), *np.median(deg, axis=0), *_gains(mm)))
    both = [pair for pair in errors.objects if np.all(np.isfinite(pair))]
    if both:
        mm = 1000.0 * np.array(both, dtype=np.float64)
        rows.append(("objects, ADD(-S)", len(both), *np.median(mm, axis=0), None, None, *_gains(mm)))
    names = ("what", "times", "before mm", "after mm", "before deg", "after deg", "halved %", "worse %")
    return Table(
        "Bundle adjustment",
        tuple(Column(name, d) for name, d in zip(names, (0, 0, 1, 1, 2, 2, 0, 0), strict=True)),
        tuple(rows),
        "Median errors in the headset's frame at the steps that were adjusted, without and with what the pictures "
        "show. halved, worse: share whose distance error is at most half as large, or larger.",
    )


def board_table(board: dict[str, BoardErrors], headset: str) -> Table:
    """One row per static camera that was seen by a ChArUco board: medians by the board and of the run."""
    rows: list[tuple[Cell, ...]] = []
    for name, errors in board.items():
        found = [error for error in errors.run if error is not None]
        own = (median([e.centre_mm for e in found]), median([e.rotation_deg for e in found])) if found else (None, None)
        by_board = median([e.centre_mm for e in errors.board]), median([e.rotation_deg for e in errors.board])
        row = (f"{name} in {headset}", len(errors.board), *by_board, 100 * len(found) / len(errors.board), *own)
        rows.append(row)
    names = ("camera", "times", "board mm", "board deg", "run has pose %", "run mm", "run deg")
    return Table(
        "Beside the ChArUco board",
        tuple(Column(name, d) for name, d in zip(names, (0, 0, 1, 2, 0, 1, 2), strict=True)),
        tuple(rows),
        "Median errors at the steps at which both cameras read the board: by the board in one picture of each, and of "
        "this run, which does not look at the board.",
    )


def _gains(mm: FloatArray) -> tuple[float, float]:
    """Percent of pairs (n, 2) of errors that are halved, and that are worse."""
    return 100 * float(np.mean(mm[:, 1] <= mm[:, 0] / 2)), 100 * float(np.mean(mm[:, 1] > mm[:, 0]))


def object_table(errors: RunErrors, catalogue: Catalogue) -> Table:
    """One row per class and a mean over classes: objects of the scene graph in the headset's frame."""
    rows: list[tuple[Cell, ...]] = [
        (catalogue[obj_id].name, len(found), *_object_cells(found, catalogue[obj_id].diameter))
        for obj_id, found in errors.objects.items()
    ]
    if rows:
        means = [mean_cell(row[i] for row in rows) for i in (2, 3, 4)]
        rows.append(("mean of classes", sum(len(found) for found in errors.objects.values()), *means, None))
    names = ("object", "asked", "found %", "within 0.1 d %", "AUC %", "median mm")
    decimals = (0, 0, 0, 1, 1, 1)
    note = (
        "ADD, or ADD-S for symmetric objects, of the objects that any camera of the step sees; a missing object is an "
        "infinite error. within 0.1 d: below a tenth of the diameter. AUC: up to 100 mm, as in PoseCNN."
    )
    columns = tuple(Column(name, d) for name, d in zip(names, decimals, strict=True))
    return Table("Object errors", columns, tuple(rows), note)


def statements(run: RunResult, errors: RunErrors | None, catalogue: Catalogue) -> tuple[list[str], list[str]]:
    """Plain sentences on how the run went: what was reached, and warnings."""
    facts, warnings = _coverage_statements(run)
    if not run.complete:
        warnings.insert(0, "The run was interrupted; the figures are those of the steps done.")
    if errors is None:
        return facts, warnings
    found = [error for series in errors.cameras.values() for error in series if error is not None]
    if found:
        mm, deg = (float(np.median([getattr(e, n) for e in found])) for n in ("centre_mm", "rotation_deg"))
        facts.append(f"Median error of the static cameras in the headset's frame: {mm:.1f} mm and {deg:.2f} deg.")
        if mm > GOOD_MM or deg > GOOD_DEG:
            warnings.append(f"Camera poses are poor: the median is beyond {GOOD_MM:g} mm or {GOOD_DEG:g} deg.")
        inside = float(np.mean([bool(e.inside) for e in found]))
        if inside < 0.8:
            warnings.append(
                f"The stated uncertainties are too small: {100 * inside:.0f} % of the camera poses lie in their 95 % "
                "ellipsoid."
            )
    if errors.single_view:
        alone = tenth_recall({i: [e.add_or_add_s for e in found] for i, found in errors.single_view.items()}, catalogue)
        together = tenth_recall(errors.objects, catalogue)
        facts.append(
            f"Objects within a tenth of their diameter (mean of classes): {100 * alone:.0f} % of what the network is "
            f"shown in single pictures; {100 * together:.0f} % of what any camera sees, in the headset's frame."
        )
        if alone < 0.5:
            warnings.append(
                "The network is weak: in single pictures it places fewer than half of the objects to a tenth of their "
                "diameter."
            )
    return facts, warnings


def _coverage_statements(run: RunResult) -> tuple[list[str], list[str]]:
    statics = run.statics
    shares = {
        name: float(np.mean([step.camera(name).status != "not placed" for step in run.steps])) for name in statics
    }
    placed = sum(share > 0 for share in shares.values())
    facts = [f"{placed} of {len(statics)} static cameras were placed in {len(run.steps)} steps."]
    seconds = [sum(step.seconds.values()) for step in run.steps]
    facts.append(f"A step of all cameras takes {1000 * float(np.median(seconds)):.0f} ms (median).")
    warnings = [
        f"Camera {name} was never placed."
        if share == 0
        else f"Camera {name} had a pose at {100 * share:.0f} % of steps."
        for name, share in shares.items()
        if share < 0.5
    ]
    return facts, warnings


def _camera_row(name: str, series: Sequence[CameraError | None]) -> tuple[Cell, ...]:
    found = [error for error in series if error is not None]
    if not found:
        return name, 0.0, 0.0, *[None] * 7
    mm, deg = (np.array([getattr(e, n) for e in found]) for n in ("centre_mm", "rotation_deg"))
    good = float(np.sum((mm < GOOD_MM) & (deg < GOOD_DEG)))
    judged = [e.inside for e in found if e.inside is not None]
    inside = 100 * float(np.mean(judged)) if judged else None
    quantiles = [float(np.percentile(values, q)) for q in (50, 90) for values in (mm, deg)]
    last = (found[-1].centre_mm, found[-1].rotation_deg) if series[-1] is not None else (None, None)
    return name, 100 * len(found) / len(series), 100 * good / len(series), *quantiles, *last, inside


def _object_cells(errors: Sequence[float], diameter: float) -> tuple[Cell, ...]:
    found = 100 * float(np.mean(np.isfinite(errors)))
    tenth, area = 100 * recall(errors, TENTH * diameter), 100 * auc_posecnn(errors)
    return found, tenth, area, 1000 * median(errors)
