"""Writes the instrument set as a BOP `models/` folder, with the assemblies beside the meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from datagen.instruments.assemblies import ASSEMBLIES, Assembly
from datagen.instruments.catalogue import INSTRUMENTS, mesh
from multicam.dataset.bop_writer import write_models as write_bop_models
from multicam.dataset.objects import MILLIMETRE, Catalogue, ObjectModel
from multicam.files import write_json
from multicam.geometry.keypoints import sample_keypoints
from multicam.progress import Progress, SilentProgress


def write_models(folder: Path, keypoints: int, seed: int, progress: Progress | None = None) -> None:
    """Writes PLY meshes, models_info.json, keypoints.json and assemblies.json, all in millimetres.

    The same arguments always give the same bytes. `assemblies.json` is a list of groups, each with its `name`
    and its `parts`; a part has `obj_id`, `name`, `R_group_from_object` (9 numbers, row-major) and
    `t_group_from_object` (3 numbers, millimetres).

    Args:
        keypoints: how many keypoints an object gets, by farthest point sampling.
        seed: of the surface samples that the keypoints are chosen from; every object has its own stream.
    """
    steps = (progress or SilentProgress()).track(INSTRUMENTS, "instruments")
    meshes = {}
    models = {}
    for part in steps:
        shape = mesh(part.name)
        points = sample_keypoints(shape, keypoints, np.random.default_rng((seed, part.obj_id)))
        meshes[part.obj_id] = shape
        models[part.obj_id] = ObjectModel(part.obj_id, part.name, shape.diameter(), part.symmetries, shape.box, points)
    write_json(folder / "assemblies.json", [_assembly_row(a) for a in ASSEMBLIES], indent=1)
    write_bop_models(folder, Catalogue(models), meshes)


def _assembly_row(assembly: Assembly) -> dict[str, Any]:
    parts = [
        {
            "obj_id": mount.obj_id,
            "name": mount.name,
            "R_group_from_object": mount.group_from_object[:3, :3].reshape(-1).tolist(),
            "t_group_from_object": (mount.group_from_object[:3, 3] / MILLIMETRE).tolist(),
        }
        for mount in assembly.mounts
    ]
    return {"name": assembly.name, "parts": parts}
