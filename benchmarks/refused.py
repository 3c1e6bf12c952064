"""Could the refused cameras have been placed? Counts, with the truth at hand, the estimates they could be placed by.

    python benchmarks/refused.py [--bench DIR] [--every 5] [--workers 2]

An estimate is right if its centre is within 15 mm of a true object of its class across the line of sight and within
80 mm along it, and its attitude within 15 degrees at the closest symmetry. It helps if another view of the group has
the same object right. Two that help are needed to confirm a pose; a single one could be any. --every applies to YCB-V.
"""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from registration import machine, parse, register
from rich.console import Console
from rich.table import Table

from multicam.dataset.bop_reader import Instance, read_scene
from multicam.dataset.objects import Catalogue, load_catalogue
from multicam.dataset.results import Estimates, read_results
from multicam.geometry import se3
from multicam.types import ObjectEstimate

LATERAL, ALONG, TURN_DEG = 0.015, 0.08, 15.0
MOST = 3


def main() -> None:
    options = parse(__doc__, every=5)
    print(machine())
    table = Table(
        "data", "estimates", "views", "refused views", "of", *(f"{n}{'+' * (n == MOST)} help" for n in range(MOST + 1)),
        title="Right estimates of the refused views",
    )  # fmt: skip
    for dataset in sorted({path.parent for path in options.bench.glob("*/groups_*.json")}):
        catalogue = load_catalogue(dataset)
        for candidates in sorted((dataset / "results").glob("*.csv*")):
            estimates = read_results(candidates)
            for file in sorted(dataset.glob("groups_*.json"), key=lambda path: int(path.stem[7:])):
                groups = json.loads(file.read_text())
                groups["groups"] = groups["groups"][:: options.every if dataset.name == "ycbv" else 1]
                answer = register(dataset, candidates, groups, options.workers)
                counts = count(dataset, catalogue, estimates, groups["groups"], answer["groups"])
                views = sum(len(group["im_ids"]) for group in groups["groups"])
                table.add_row(
                    dataset.name, candidates.name.split("_")[0], file.stem[7:], str(sum(counts.values())), str(views),
                    *(str(counts[n]) for n in range(MOST + 1)),
                )  # fmt: skip
    Console(width=170).print(table)


def count(
    dataset: Path,
    catalogue: Catalogue,
    estimates: Estimates,
    groups: list[dict[str, Any]],
    answers: list[dict[str, Any]],
) -> Counter[int]:
    """Refused views by the number of estimates that help."""
    scenes = {group["scene_id"] for group in groups}
    records = {s: {r.im_id: r.instances for r in read_scene(dataset / "test" / f"{s:06d}")} for s in scenes}
    counts: Counter[int] = Counter()
    for group, answer in zip(groups, answers, strict=True):
        scene = group["scene_id"]
        right = {
            im_id: right_instances(estimates.get((scene, im_id), []), records[scene][im_id], catalogue)
            for im_id in group["im_ids"]
        }
        for refused in map(int, answer["refusals"]):
            elsewhere = set[int]().union(*(found for im_id, found in right.items() if im_id != refused))
            counts[min(MOST, len(right[refused] & elsewhere))] += 1
    return counts


def right_instances(found: list[ObjectEstimate], instances: tuple[Instance, ...], catalogue: Catalogue) -> set[int]:
    """Positions of the labelled objects that an estimate has right; they have one order throughout a scene."""
    right: set[int] = set()
    for estimate in found:
        model = catalogue[estimate.obj_id]
        for number, instance in enumerate(instances):
            if instance.obj_id != estimate.obj_id:
                continue
            true = instance.camera_from_object
            twin = model.symmetries.closest(true, estimate.camera_from_object, model.diameter / 2)
            pose = estimate.camera_from_object @ twin
            off = np.abs(pose[:3, 3] - true[:3, 3])
            turn = np.degrees(np.linalg.norm(se3.minus(pose, true)[:3]))
            if np.hypot(*off[:2]) < LATERAL and off[2] < ALONG and turn < TURN_DEG:
                right.add(number)
    return right


if __name__ == "__main__":
    main()
