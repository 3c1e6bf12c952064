"""Cameras of registered groups before and after their adjustment on the photographs behind them (LM-O).

    python benchmarks/bundle_lmo.py [--bench DIR] [--views 3 5] [--variants joint ...]

DIR (default: $MULTICAM_BENCH, or shared/bench beside the checkout) holds score.py and lmo/. Registration is that of
`multicam register` with noise learnt from the same estimates. Figures are those of the neutral scorer.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from registration import default_bench, load_scorer, machine
from rich.console import Console
from rich.table import Table

from multicam.bundle.adjustment.adjust import adjust
from multicam.bundle.adjustment.config import AdjustmentConfig
from multicam.bundle.adjustment.registered import EstimateNoise, component_of, scene_of
from multicam.bundle.adjustment.scene import Body, Picture
from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.viewpoints.cache import load_viewpoints
from multicam.bundle.viewpoints.generate import ViewpointConfig
from multicam.commands.candidates import read_candidates
from multicam.commands.view_groups import ViewGroup, prediction, read_groups
from multicam.dataset.bop_reader import list_scenes, read_image, read_scene
from multicam.dataset.objects import Catalogue, load_catalogue
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import load_mesh
from multicam.progress import RichProgress, SilentProgress
from multicam.registration import LearningConfig, RegistrationConfig, learn_noise, register_views
from multicam.types import Registration, View

VARIANTS = {
    "joint": AdjustmentConfig(),
    "joint, scenery": AdjustmentConfig(scenery=SceneryConfig()),
    "in turns (paper)": AdjustmentConfig(joint=False),
    "without modelled occlusion": AdjustmentConfig(modelled_occlusion=False),
}
COLUMNS = (
    "placed",
    "mean_t",
    "median_t",
    "p90_t",
    "mean_r",
    "median_r",
    "good",
    "fine",
    "false",
    "nees95",
    "ms_median",
)


class Photographs:
    """Pictures, bodies and estimates of LM-O."""

    def __init__(self, dataset: Path) -> None:
        self.catalogue: Catalogue = load_catalogue(dataset)
        self.pictures: dict[tuple[int, int], Picture] = {}
        for scene in list_scenes(dataset / "test"):
            for record in read_scene(scene):
                image = read_image(record.rgb_path)
                camera = Camera(record.camera_matrix, image.shape[1], image.shape[0])
                self.pictures[record.scene_id, record.im_id] = Picture(image, camera)
        meshes = {o: load_mesh(dataset / f"models/obj_{o:06d}.ply", 1e-3) for o in self.catalogue.obj_ids}
        models = load_viewpoints(meshes, ViewpointConfig(), RichProgress())
        self.bodies = {o: Body(models[o], meshes[o]) for o in meshes}
        self.estimates = read_candidates(dataset / "results/megapose_lmo-test.csv.gz", self.catalogue)

    def views(self, group: ViewGroup) -> list[View]:
        """What was estimated in the images of a group."""
        return [
            View(
                str(im_id),
                tuple(self.estimates.get((group.scene_id, im_id), ())),
                self.pictures[group.scene_id, im_id].camera.matrix,
            )
            for im_id in group.im_ids
        ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bench", type=Path, default=default_bench())
    parser.add_argument("--views", type=int, nargs="*", default=[3, 5])
    parser.add_argument("--variants", nargs="*", default=list(VARIANTS), choices=VARIANTS)
    options = parser.parse_args()
    print(machine())
    dataset, scorer = options.bench / "lmo", load_scorer(options.bench / "score.py")
    truth, photographs = scorer.Truth(dataset), Photographs(dataset)
    table = Table("views", "poses", *COLUMNS, title="LM-O, MegaPose estimates")
    for count in options.views:
        chosen = json.loads((dataset / f"groups_{count}.json").read_text())
        groups = read_groups(dataset / f"groups_{count}.json")
        seen = [photographs.views(group) for group in groups]
        learned = learn_noise(
            seen, photographs.catalogue, RegistrationConfig(), LearningConfig(), map, SilentProgress()
        )
        registered = [register_views(views, photographs.catalogue, RegistrationConfig(), learned) for views in seen]
        noise = EstimateNoise(RegistrationConfig().noise, learned)
        answers = {"registered": [prediction(g, r, 0.0) for g, r in zip(groups, registered, strict=True)]}
        for name in options.variants:
            answers[name] = [
                adjusted(photographs, group, views, registration, noise, VARIANTS[name])
                for group, views, registration in zip(groups, seen, registered, strict=True)
            ]
        for name, entries in answers.items():
            figures = scorer.score(truth, chosen, {"groups": entries})
            table.add_row(str(count), name, *(f"{figures[column]:.2f}" for column in COLUMNS))
    Console(width=180).print(table)


def adjusted(
    photographs: Photographs,
    group: ViewGroup,
    views: list[View],
    registration: Registration,
    noise: EstimateNoise,
    config: AdjustmentConfig,
) -> dict[str, Any]:
    """The prediction of one group after the adjustment of its components."""
    pictures = {str(im_id): photographs.pictures[group.scene_id, im_id] for im_id in group.im_ids}
    began, components = time.perf_counter(), []
    for component in registration.components:
        scene, state = scene_of(component, views, pictures, photographs.bodies, photographs.catalogue, noise)
        components.append(component_of(component, adjust(scene, state, config)))
    return prediction(group, replace(registration, components=tuple(components)), time.perf_counter() - began)


if __name__ == "__main__":
    main()
