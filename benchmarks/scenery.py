"""What pictures add to registration on LM-O, and what of it hangs on the printed squares of its board.

    python benchmarks/scenery.py [--bench DIR] [--every 1]

Points whose surroundings (25 pixels) are an eighth white and an eighth black are left out in the last row, whether they
lie on the board or not. With --picture FILE one photograph is written with the points kept in green, the others in red.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from registration import default_bench, load_scorer, machine
from rich.console import Console
from rich.table import Table

from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.scenery.features import Features, find_features
from multicam.bundle.scenery.scenery import Scenery
from multicam.commands.candidates import read_candidates
from multicam.commands.view_groups import ViewGroup, prediction, read_groups
from multicam.dataset.bop_reader import list_scenes, read_image, read_scene
from multicam.dataset.objects import load_catalogue
from multicam.geometry.camera import Camera
from multicam.matching.arrays import BoolArray
from multicam.progress import RichProgress, SilentProgress
from multicam.registration import LearningConfig, RegistrationConfig, learn_noise, register_views
from multicam.types import ImageArray, View

COLUMNS = ("placed", "mean_t", "mean_r", "median_t", "good", "fine", "false", "nees95")
SIDE, SHARE = 25, 0.12
WHITE, BLACK, GREY = 140, 90, 70
"""Brightness from which a pixel counts as white, and below which as black, and saturation below which as grey."""

Key = tuple[int, int]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bench", type=Path, default=default_bench())
    parser.add_argument("--every", type=int, default=1, help="use every n-th group only")
    parser.add_argument("--picture", type=Path, help="where to draw the points of one photograph")
    options = parser.parse_args()
    print(machine())
    dataset, scorer, config = options.bench / "lmo", load_scorer(options.bench / "score.py"), SceneryConfig()
    truth, catalogue = scorer.Truth(dataset), load_catalogue(dataset)
    estimates = read_candidates(dataset / "results/megapose_lmo-test.csv.gz", catalogue)
    every: dict[Key, Features] = {}
    plain: dict[Key, Features] = {}
    cameras: dict[Key, Camera] = {}
    for key, image, camera in RichProgress().track(photographs(dataset / "test"), "points", None):
        found = find_features(image, camera, config)
        kept = ~on_print(image, found, camera)
        every[key], cameras[key] = found, camera
        plain[key] = Features(found.rays[kept], found.descriptors[kept], found.pixel)
        if options.picture and len(every) == 1:
            draw(options.picture, image, found, camera, kept)
    share = sum(len(each.rays) for each in plain.values()) / sum(len(each.rays) for each in every.values())
    table = Table("views", "points", *COLUMNS, title=f"LM-O, MegaPose; off the print {share:.0%} of all points")
    for count in (3, 5):
        chosen = json.loads((dataset / f"groups_{count}.json").read_text())
        chosen["groups"] = chosen["groups"][:: options.every]
        groups = read_groups(dataset / f"groups_{count}.json")[:: options.every]
        views = [views_of(group, estimates, cameras) for group in groups]
        noise = learn_noise(views, catalogue, RegistrationConfig(), LearningConfig(), map, SilentProgress())
        for name, points in (("none", None), ("all", every), ("off the print", plain)):
            entries = []
            for group, seen in zip(groups, views, strict=True):
                scenery = None
                if points is not None:
                    scenery = Scenery({str(i): points[group.scene_id, i] for i in group.im_ids}, config)
                found = register_views(seen, catalogue, RegistrationConfig(), noise, scenery)
                entries.append(prediction(group, found, 0.0))
            figures = scorer.score(truth, chosen, {"groups": entries})
            table.add_row(str(count), name, *(f"{figures[column]:.2f}" for column in COLUMNS))
    Console(width=140).print(table)


def photographs(split: Path) -> Iterator[tuple[Key, ImageArray, Camera]]:
    for scene in list_scenes(split):
        for record in read_scene(scene):
            image = read_image(record.rgb_path)
            yield (record.scene_id, record.im_id), image, Camera(record.camera_matrix, image.shape[1], image.shape[0])


def views_of(group: ViewGroup, estimates: dict, cameras: dict[Key, Camera]) -> list[View]:
    keys = [(group.scene_id, im_id) for im_id in group.im_ids]
    return [View(str(key[1]), tuple(estimates.get(key, ())), cameras[key].matrix) for key in keys]


def on_print(image: ImageArray, features: Features, camera: Camera) -> BoolArray:
    """(n,) points with black and white around them."""
    _, saturation, value = cv2.split(cv2.cvtColor(image, cv2.COLOR_RGB2HSV))
    white, black = (value > WHITE) & (saturation < GREY), value < BLACK
    shares = [cv2.boxFilter(each.astype(np.float32), -1, (SIDE, SIDE)) for each in (white, black)]
    column, row = pixels(features, camera).T
    return (shares[0][row, column] > SHARE) & (shares[1][row, column] > SHARE)


def pixels(features: Features, camera: Camera) -> np.ndarray:
    """(n, 2) column and row of each point."""
    at = features.rays @ camera.matrix[:2, :2].T + camera.matrix[:2, 2]
    return np.clip(at.round().astype(int), 0, [camera.width - 1, camera.height - 1])


def draw(path: Path, image: ImageArray, features: Features, camera: Camera, kept: BoolArray) -> None:
    canvas = np.ascontiguousarray(image[..., ::-1])
    for place, each in zip(pixels(features, camera).tolist(), kept, strict=True):
        cv2.circle(canvas, place, 2, (0, 200, 0) if each else (0, 0, 220), -1)
    cv2.imwrite(str(path), canvas)


if __name__ == "__main__":
    main()
