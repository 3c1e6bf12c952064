"""Single-view estimates in BOP results format: scene_id,im_id,obj_id,score,R,t,time (t in mm)."""

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
from multicam.types import ObjectEstimate

HEADER = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")

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
    if header != HEADER:
        raise DataError(
            f"{path} starts with {','.join(header)[:80]!r}; a BOP results file starts with {','.join(HEADER)!r}."
        )
    estimates: Estimates = defaultdict(list)
    for number, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        try:
            if len(row) != len(HEADER):
                raise ValueError(f"{len(HEADER)} columns are needed, got {len(row)}")
            scene, image, obj_id, score, rotation, translation, _ = row
            pose = transform_from_bop([float(v) for v in rotation.split()], [float(v) for v in translation.split()])
            if not np.isfinite(float(score)):
                raise ValueError("score is not finite")
            key = int(scene), int(image)
            estimates[key].append(ObjectEstimate(int(obj_id), float(score), pose))
        except ValueError as error:
            raise DataError(f"{path}, line {number}: {error}.") from error
    return dict(estimates)


def write_results(path: Path, rows: Iterable[tuple[int, int, ObjectEstimate, float]]) -> None:
    """Writes (scene_id, im_id, estimate, seconds for the whole image or -1) rows, atomically."""
    lines = [",".join(HEADER)]
    for scene_id, im_id, estimate, seconds in rows:
        pose = estimate.camera_from_object
        rotation = " ".join(f"{v:.9f}" for v in pose[:3, :3].reshape(-1))
        translation = " ".join(f"{v:.6f}" for v in pose[:3, 3] / MILLIMETRE)
        lines.append(
            f"{scene_id},{im_id},{estimate.obj_id},{estimate.score:.6f},{rotation},{translation},{seconds:.6f}"
        )
    write_text(path, "\n".join(lines) + "\n")
