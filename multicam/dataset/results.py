"""Single-view estimates in BOP results format: scene_id,im_id,obj_id,score,R,t,time (t in mm).

BOP's tools refuse other columns. A file of ours may have one more, `covariance`: that of the right perturbation
[rotation rad; translation mm], its upper triangle row by row, 21 numbers, or nothing where none is known.
"""

from __future__ import annotations

import csv
import gzip
import io
import zlib
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from multicam.dataset.units import MILLIMETRE, transform_from_bop
from multicam.errors import DataError
from multicam.files import require_file, write_text
from multicam.types import FloatArray, ObjectEstimate

HEADER = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")
WITH_COVARIANCE = (*HEADER, "covariance")

Estimates = dict[tuple[int, int], list[ObjectEstimate]]
"""(scene_id, im_id) to the estimates of that image, in file order."""


def read_results(path: Path) -> Estimates:
    """Reads a results file, plain or gzipped.

    Raises:
        DataError: missing file, wrong header, or a row that is no pose; the sentence names the line.
    """
    require_file(path, "results file")
    try:
        data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
        rows = list(csv.reader(io.StringIO(data.decode())))
    except (OSError, EOFError, zlib.error, UnicodeDecodeError, csv.Error) as error:
        raise DataError(
            f"{path} cannot be read: {error}; it must be CSV text, gzipped if its name ends in .gz."
        ) from error
    header = tuple(rows[0]) if rows else ()
    if header not in (HEADER, WITH_COVARIANCE):
        raise DataError(
            f"{path} starts with {','.join(header)[:80]!r}; a BOP results file starts with {','.join(HEADER)!r}."
        )
    estimates: Estimates = defaultdict(list)
    for number, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        try:
            if len(row) != len(header):
                raise ValueError(f"{len(header)} columns are needed, got {len(row)}")
            scene, image, obj_id, score, rotation, translation, _, *rest = row
            pose = transform_from_bop([float(v) for v in rotation.split()], [float(v) for v in translation.split()])
            if not np.isfinite(float(score)):
                raise ValueError("score is not finite")
            key = int(scene), int(image)
            covariance = _read_covariance(rest[0]) if rest and rest[0] else None
            estimates[key].append(ObjectEstimate(int(obj_id), float(score), pose, covariance))
        except ValueError as error:
            raise DataError(f"{path}, line {number}: {error}.") from error
    return dict(estimates)


def write_results(
    path: Path, rows: Iterable[tuple[int, int, ObjectEstimate, float]], covariances: bool = False
) -> None:
    """Writes (scene_id, im_id, estimate, seconds for the whole image or -1) rows, atomically.

    Args:
        covariances: whether to add the column that BOP does not know.
    """
    lines = [",".join(WITH_COVARIANCE if covariances else HEADER)]
    for scene_id, im_id, estimate, seconds in rows:
        pose = estimate.camera_from_object
        rotation = " ".join(f"{v:.9f}" for v in pose[:3, :3].reshape(-1))
        translation = " ".join(f"{v:.6f}" for v in pose[:3, 3] / MILLIMETRE)
        line = f"{scene_id},{im_id},{estimate.obj_id},{estimate.score:.6f},{rotation},{translation},{seconds:.6f}"
        lines.append(f"{line},{_covariance_text(estimate.covariance)}" if covariances else line)
    write_text(path, "\n".join(lines) + "\n")


_UPPER = np.triu_indices(6)
_UNITS = np.repeat([1.0, 1 / MILLIMETRE], 3)
"""Of a twist in BOP's units."""


def _covariance_text(covariance: FloatArray | None) -> str:
    return "" if covariance is None else " ".join(f"{v:.9g}" for v in (covariance * np.outer(_UNITS, _UNITS))[_UPPER])


def _read_covariance(text: str) -> FloatArray:
    numbers = np.array([float(v) for v in text.split()])
    if len(numbers) != len(_UPPER[0]) or not np.isfinite(numbers).all():
        raise ValueError(f"a covariance has {len(_UPPER[0])} finite numbers, got {text[:80]!r}")
    half = np.zeros((6, 6))
    half[_UPPER] = numbers
    return (half + np.triu(half, 1).T) / np.outer(_UNITS, _UNITS)
