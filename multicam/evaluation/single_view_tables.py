"""Errors of single-view estimates as tables: per object, per bin of distance and of visibility."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.evaluation.recall import auc_posecnn, median, recall
from multicam.evaluation.report import Cell, Column, Table, mean_cell
from multicam.evaluation.selection import DISTANCE_BINS, VISIBILITY_BINS, Selection
from multicam.evaluation.single_view import ObjectErrors

Errors = Mapping[int, Sequence[ObjectErrors]]
"""Errors by class."""

TENTH = 0.1
"""Share of the diameter within which a pose counts as right: ADD(-S)-0.1d."""

MEAN = "mean of classes"


def single_view_table(errors: Errors, catalogue: Catalogue) -> Table:
    """One row per class and a mean over classes."""
    rows = {catalogue[obj_id].name: {obj_id: found} for obj_id, found in errors.items()}
    if rows:
        rows[MEAN] = dict(errors)
    return _table("Single-view object errors", "object", rows, catalogue, _has_vsd(errors))


def distance_table(errors: Errors, catalogue: Catalogue) -> Table:
    """One row per bin of camera distance; figures are means over the classes in it."""
    return _table("By distance", "distance", _binned(errors, DISTANCE_BINS), catalogue, _has_vsd(errors))


def visibility_table(errors: Errors, catalogue: Catalogue) -> Table | None:
    """One row per bin of visible fraction; None where the split states none."""
    if any(e.truth.visible_fraction is None for found in errors.values() for e in found):
        return None
    return _table("By visibility", "visible", _binned(errors, VISIBILITY_BINS), catalogue, _has_vsd(errors))


def add_table(errors: Errors, catalogue: Catalogue) -> Table:
    """ADD and ADD-S of every class, whatever its symmetry."""
    rows: list[tuple[Cell, ...]] = []
    for obj_id, found in errors.items():
        model = catalogue[obj_id]
        adds, adds_s = [e.add for e in found], [e.add_s for e in found]
        limit = TENTH * model.diameter
        figures = recall(adds, limit), recall(adds_s, limit), auc_posecnn(adds), auc_posecnn(adds_s)
        kind = "symmetric" if model.symmetries else ""
        rows.append((model.name, kind, *(100 * value for value in figures)))
    if rows:
        rows.append((MEAN, "", *(mean_cell(row[i] for row in rows) for i in range(2, 6))))
    names = ("object", "", "ADD 0.1 d %", "ADD-S 0.1 d %", "ADD AUC %", "ADD-S AUC %")
    note = "0.1 d: below a tenth of the diameter. AUC: up to 100 mm, as in PoseCNN."
    return Table("ADD and ADD-S", tuple(Column(name) for name in names), tuple(rows), note)


def tenth_recall(errors: Mapping[int, Sequence[float]], catalogue: Catalogue) -> float:
    """Share of errors ADD(-S) by class that are below a tenth of the diameter, mean of classes; 0 of no errors."""
    shares = [recall(found, TENTH * catalogue[obj_id].diameter) for obj_id, found in errors.items()]
    return float(np.mean(shares)) if shares else 0.0


def _table(
    title: str, first: str, rows: Mapping[str, Mapping[int, Sequence[ObjectErrors]]], catalogue: Catalogue, vsd: bool
) -> Table:
    shares = ("AR VSD %", "AR MSSD %", "AR MSPD %", "AR %") if vsd else ("AR MSSD %", "AR MSPD %", "AR without VSD %")
    names = (first, "asked", "found %", "within 0.1 d %", "AUC %", *shares, "median mm")
    columns = tuple(Column(name, 0 if i < 3 else 1) for i, name in enumerate(names))
    note = (
        "ADD, or ADD-S for symmetric objects; a missing estimate is an infinite error. Objects less than 10 % visible "
        "are not asked for. AUC: up to 100 mm, as in PoseCNN. AR: BOP's thresholds"
        + ("." if vsd else "; without depth images there is no VSD, and AR is the mean of the two others.")
    )
    return Table(title, columns, tuple(_row(name, errors, catalogue, vsd) for name, errors in rows.items()), note)


def _row(name: str, errors: Errors, catalogue: Catalogue, vsd: bool) -> tuple[Cell, ...]:
    """Means over classes of one group of objects; of a single class, its own figures."""
    figures = np.array([_figures(found, catalogue[obj_id].diameter, vsd) for obj_id, found in errors.items() if found])
    everything = [e.add_or_add_s for found in errors.values() for e in found]
    means = figures.mean(axis=0).tolist() if everything else [None] * (7 if vsd else 6)
    return name, len(everything), *means, None if name == MEAN else 1000 * median(everything)


def _figures(errors: Sequence[ObjectErrors], diameter: float, vsd: bool) -> list[float]:
    adds = [e.add_or_add_s for e in errors]
    shares = [float(np.mean([e.mssd_share for e in errors])), float(np.mean([e.mspd_share for e in errors]))]
    if vsd:
        shares.insert(0, float(np.mean([e.vsd_share or 0.0 for e in errors])))
    figures = [np.mean(np.isfinite(adds)), recall(adds, TENTH * diameter), auc_posecnn(adds), *shares, np.mean(shares)]
    return [100 * float(value) for value in figures]


def _binned(errors: Errors, bins: Mapping[str, Selection]) -> dict[str, dict[int, list[ObjectErrors]]]:
    return {
        name: {obj_id: [e for e in found if selection.takes(e.truth)] for obj_id, found in errors.items()}
        for name, selection in bins.items()
    }


def _has_vsd(errors: Errors) -> bool:
    return all(e.vsd_share is not None for found in errors.values() for e in found) and bool(errors)
