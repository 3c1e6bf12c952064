"""Files of `multicam register`: view groups in, predictions out. Formats: docs/registration.md."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from multicam.errors import DataError
from multicam.files import read_json, write_atomic
from multicam.types import FloatArray, Registration


@dataclass(frozen=True)
class ViewGroup:
    """Images of one scene that are to be registered with each other."""

    group_id: int
    scene_id: int
    im_ids: tuple[int, ...]


def read_groups(path: Path) -> list[ViewGroup]:
    """Reads `{"groups": [{"group_id": 0, "scene_id": 48, "im_ids": [1, 36, 47]}, ...]}`.

    Raises:
        DataError: no such form, a group of fewer than two images, an image or a group number given twice.
    """
    document = read_json(path)
    rows = document.get("groups") if isinstance(document, dict) else None
    if not isinstance(rows, list) or not rows:
        raise DataError(f'{path} must hold {{"groups": [...]}} with at least one group.')
    groups = [_read_group(path, number, row) for number, row in enumerate(rows)]
    seen: set[int] = set()
    for group in groups:
        if group.group_id in seen:
            raise DataError(f"{path} holds two groups with group_id {group.group_id}; each needs its own number.")
        seen.add(group.group_id)
    return groups


def _read_group(path: Path, number: int, row: Any) -> ViewGroup:
    where = f"{path}: entry {number} of its groups"
    if not isinstance(row, dict) or not {"group_id", "scene_id", "im_ids"} <= row.keys():
        raise DataError(f"{where} must be an object with group_id, scene_id and im_ids; it is {json.dumps(row)[:80]}.")
    im_ids = row["im_ids"]
    if not isinstance(im_ids, list) or not all(type(n) is int for n in (row["group_id"], row["scene_id"], *im_ids)):
        raise DataError(f"{where} must hold whole numbers and im_ids a list of them; it is {json.dumps(row)[:80]}.")
    group_id = row["group_id"]
    if len(im_ids) < 2:
        count = "no image" if not im_ids else "one image"
        raise DataError(f"group {group_id} in {path} holds {count}; at least two views are needed to relate cameras.")
    if len(set(im_ids)) < len(im_ids):
        raise DataError(f"group {group_id} in {path} names an image twice: {im_ids}.")
    return ViewGroup(group_id, row["scene_id"], tuple(im_ids))


def prediction(group: ViewGroup, registration: Registration, seconds: float) -> dict[str, Any]:
    """One entry of the predictions file; a view's name is its image number."""
    return {
        "group_id": group.group_id,
        "seconds": seconds,
        "components": [
            {
                "cameras": [
                    {
                        "im_id": int(camera.view_id),
                        "world_from_camera": _rows(camera.world_from_camera),
                        "covariance": _rows(camera.covariance),
                    }
                    for camera in component.cameras
                ],
                "objects": [
                    {
                        "obj_id": placed.obj_id,
                        "score": placed.score,
                        "world_from_object": _rows(placed.world_from_object),
                        "covariance": _rows(placed.covariance),
                        "seen_in": [int(view_id) for view_id, _ in placed.supports],
                    }
                    for placed in component.objects
                ],
            }
            for component in registration.components
        ],
        "refusals": registration.refusals,
    }


def write_predictions(path: Path, entries: Iterable[dict[str, Any]]) -> None:
    """Writes `{"groups": [...]}` entry by entry as they come; the file appears when the last one is written."""
    with write_atomic(path) as temporary, temporary.open("w", encoding="utf-8") as stream:
        stream.write('{"groups": [')
        for number, entry in enumerate(entries):
            stream.write(("\n" if number == 0 else ",\n") + json.dumps(entry, allow_nan=False))
        stream.write("\n]}\n")


def _rows(matrix: FloatArray) -> list[list[float]]:
    # Ten decimals are a tenth of a nanometre; shorter numbers halve the file.
    return np.round(matrix, 10).tolist()
