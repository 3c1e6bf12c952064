"""Registration on published estimates that were made worse on purpose: one command, one table.

    python benchmarks/degraded.py [--bench DIR] [--every 10] [--workers 2]

CosyPose's estimates on YCB-V, groups of three, with fixed seeds: the commonest class (it is in half of the scenes) is
always 5 or 20 % too far away, 30 % of false detections of absent classes are added, and only 4, 3 or 2 classes of each
scene are kept.
"""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from registration import load_scorer, machine, parse, register
from rich.console import Console
from rich.table import Table

from multicam.dataset.results import Estimates, read_results, write_results
from multicam.geometry import se3, so3
from multicam.types import ObjectEstimate

COLUMNS = {"placed": "placed %", "mean_t": "mean mm", "good": "good %", "false": "false %", "nees95": "nees95 %"}

FALSE_SHARE = 0.3
"""False detections added, as a share of all estimates."""


def main() -> None:
    options = parse(__doc__)
    dataset = options.bench / "ycbv"
    scorer = load_scorer(options.bench / "score.py")
    truth = scorer.Truth(dataset)
    groups = json.loads((dataset / "groups_3.json").read_text())
    groups["groups"] = groups["groups"][:: options.every]
    estimates = read_results(next((dataset / "results").glob("cosypose*")))
    print(machine())
    table = Table("degraded by", *COLUMNS.values(), title="YCB-V, CosyPose, threes")
    with tempfile.TemporaryDirectory() as folder:
        for name, degrade in degradations().items():
            candidates = Path(folder) / "candidates.csv"
            changed = degrade(estimates, np.random.default_rng(0))
            write_results(candidates, [(*key, estimate, -1.0) for key, found in changed.items() for estimate in found])
            figures = scorer.score(truth, groups, register(dataset, candidates, groups, options.workers), 4)
            table.add_row(name, *(f"{figures[column]:.2f}" if column in figures else "" for column in COLUMNS))
    Console(width=120).print(table)


def degradations() -> dict[str, Callable[[Estimates, np.random.Generator], Estimates]]:
    """Name to what is done to the estimates."""
    return {
        "one class 5 % too far": lambda estimates, _: too_far(estimates, 1.05),
        "one class 20 % too far": lambda estimates, _: too_far(estimates, 1.2),
        "30 % false detections": false_detections,
        "4 objects kept": lambda estimates, rng: only_some(estimates, rng, 4),
        "3 objects kept": lambda estimates, rng: only_some(estimates, rng, 3),
        "2 objects kept": lambda estimates, rng: only_some(estimates, rng, 2),
    }


def too_far(estimates: Estimates, factor: float) -> Estimates:
    """The commonest class, moved away from the camera along its ray."""
    commonest = Counter(e.obj_id for found in estimates.values() for e in found).most_common(1)[0][0]

    def moved(estimate: ObjectEstimate) -> ObjectEstimate:
        pose = estimate.camera_from_object.copy()
        pose[:3, 3] *= factor if estimate.obj_id == commonest else 1.0
        return replace(estimate, camera_from_object=pose)

    return {key: [moved(estimate) for estimate in found] for key, found in estimates.items()}


def false_detections(estimates: Estimates, rng: np.random.Generator) -> Estimates:
    """Random poses, where objects could be, of classes that the scene does not hold."""
    classes = sorted({e.obj_id for found in estimates.values() for e in found})
    changed: Estimates = {}
    for key, found in estimates.items():
        absent = [o for o in classes if o not in classes_of_scene(estimates, key[0])]
        added = [
            ObjectEstimate(int(rng.choice(absent)), 1.0, se3.from_parts(so3.random(rng), place))
            for place in rng.uniform(
                (-0.25, -0.2, 0.6), (0.25, 0.2, 1.2), size=(rng.poisson(FALSE_SHARE * len(found)), 3)
            )
        ]
        changed[key] = [*found, *added]
    return changed


def only_some(estimates: Estimates, rng: np.random.Generator, count: int) -> Estimates:
    """`count` classes of each scene."""
    scenes = sorted({scene for scene, _ in estimates})
    kept = {
        scene: set(rng.permutation(sorted(classes_of_scene(estimates, scene)))[:count].tolist()) for scene in scenes
    }
    return {key: [e for e in found if e.obj_id in kept[key[0]]] for key, found in estimates.items()}


def classes_of_scene(estimates: Estimates, scene: int) -> set[int]:
    """Classes that more than a tenth of the scene's images hold; the others are mistakes."""
    images = [found for (number, _), found in estimates.items() if number == scene]
    count = Counter(obj_id for found in images for obj_id in {e.obj_id for e in found})
    return {obj_id for obj_id, number in count.items() if number > len(images) / 10}


if __name__ == "__main__":
    main()
