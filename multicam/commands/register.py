"""`multicam register`: camera poses of view groups from single-view estimates of objects."""

from __future__ import annotations

import os
import time
from collections.abc import Generator, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.scenery.features import Features, find_features
from multicam.bundle.scenery.scenery import Scenery
from multicam.commands.candidates import read_candidates
from multicam.commands.view_groups import ViewGroup, prediction, read_groups, write_predictions
from multicam.config import load_config, parse_command, save_config
from multicam.dataset.bop_reader import find_image, read_camera_matrices, read_image
from multicam.dataset.objects import Catalogue, load_catalogue
from multicam.dataset.results import Estimates
from multicam.errors import ConfigError, DataError
from multicam.files import require_file, require_folder
from multicam.geometry.camera import Camera
from multicam.matching.learned import NoiseModel
from multicam.progress import Progress, RichProgress
from multicam.registration import LearningConfig, RegistrationConfig, learn_noise, register_views
from multicam.registration.agreement import Mapper
from multicam.types import FloatArray, View

Answer = dict[str, Any]
Task = tuple[ViewGroup, tuple[View, ...]]

CHUNK = 8
"""Groups handed to a worker at a time."""


@dataclass(frozen=True)
class RegisterConfig:
    """What to register, and how."""

    dataset: Path
    """BOP data set: models_info.json (there or in models/), and camera matrices in SPLIT/*/scene_camera.json."""
    candidates: Path
    """Single-view estimates in BOP results format (CSV, or gzipped), or with covariances, as `multicam evaluate
    --network` writes them."""
    groups: Path
    """JSON file with the view groups."""
    output: Path
    """JSON file to write; the resolved configuration goes beside it."""
    split: str = "test"
    """Split of the data set that the groups are of."""
    pictures: bool = False
    """Also look at the pictures of the split, a few seconds a group: what two of them show beside the objects confirms,
    sharpens or contradicts the poses that objects tell (docs/registration.md). Nothing of it may have moved between."""
    scenery: SceneryConfig = field(default_factory=SceneryConfig)
    """How pictures are compared."""
    workers: int = 0
    """Processes to use; 0 for one on each core. The answer is the same for any number."""
    noise: Path | None = None
    """Noise of the estimates, as an earlier run wrote it beside its predictions; learnt anew without it."""
    learning: LearningConfig = field(default_factory=LearningConfig)
    """How the noise is learnt from the agreement of the estimates."""
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    """The registration itself."""

    def __post_init__(self) -> None:
        if self.workers < 0:
            raise ConfigError(f"--workers must be 0 (one on each core) or more; it is {self.workers}.")


def main(argv: list[str]) -> None:
    """Parses the flags, registers every group, writes the predictions and prints a summary."""
    config = parse_command(
        RegisterConfig, argv, "multicam register", "Camera poses of view groups from single-view estimates of objects."
    )
    summary = register_groups(config, RichProgress())
    Console(highlight=False, markup=False, soft_wrap=True).print(f"{summary}\nPredictions: {config.output}")


def register_groups(config: RegisterConfig, progress: Progress) -> str:
    """Registers every group of a file and writes the predictions.

    Returns:
        What came out, in words.

    Raises:
        DataError: files missing or malformed, or estimates of a class that the data set does not know.
    """
    catalogue = load_catalogue(require_folder(config.dataset, "data set folder"))
    groups = read_groups(config.groups)
    estimates = read_candidates(config.candidates, catalogue)
    if not estimates:
        raise DataError(f"{config.candidates} holds its header and no estimate; there is nothing to register.")
    tasks = list(_tasks(groups, estimates, config.dataset / config.split))
    summary = Summary()
    with _mapper(config.workers or os.cpu_count() or 1) as mapper:
        noise = _noise(config, catalogue, tasks, mapper, progress)
        answers = mapper(partial(_register, config, catalogue, noise), tasks)
        tracked = progress.track(answers, "registering view groups", total=len(groups))
        write_predictions(config.output, summary.counting(tracked))
    save_config(config, config.output.with_suffix(".config.yaml"))
    save_config(noise, config.output.with_suffix(".noise.yaml"))
    return summary.text()


def _noise(
    config: RegisterConfig, catalogue: Catalogue, tasks: Sequence[Task], mapper: Mapper, progress: Progress
) -> NoiseModel:
    if config.noise is not None:
        return load_config(NoiseModel, require_file(config.noise, "noise file"))
    views = [views for _, views in tasks]
    return learn_noise(views, catalogue, config.registration, config.learning, mapper, progress)


def _tasks(groups: Sequence[ViewGroup], estimates: Estimates, split: Path) -> Iterator[Task]:
    """Each group with its views; an image of the data set without estimates is a view that saw nothing."""
    seen = {scene_id for scene_id, _ in estimates}
    matrices: dict[int, dict[int, FloatArray]] = {}
    for group in groups:
        scene = group.scene_id
        file = split / f"{scene:06d}" / "scene_camera.json"
        if scene not in matrices:
            matrices[scene] = read_camera_matrices(file.parent) if file.is_file() else {}
        # Without camera matrices nobody can tell an image that saw nothing from one that is not there.
        known = matrices[scene] or (group.im_ids if scene in seen else ())
        for im_id in group.im_ids:
            if im_id not in known and (scene, im_id) not in estimates:
                raise DataError(
                    f"group {group.group_id} names image {im_id} of scene {scene}, of which there are neither "
                    f"estimates nor an entry in {file}."
                )
        yield (
            group,
            tuple(
                View(str(im_id), tuple(estimates.get((scene, im_id), ())), matrices[scene].get(im_id))
                for im_id in group.im_ids
            ),
        )


@contextmanager
def _mapper(workers: int) -> Generator[Mapper]:
    """An ordered `map`, in this process or over several; the order makes the output the same for any number."""
    if workers == 1:
        yield map
        return
    with ProcessPoolExecutor(workers) as pool:
        yield partial(pool.map, chunksize=CHUNK)


def _register(config: RegisterConfig, catalogue: Catalogue, noise: NoiseModel, task: Task) -> Answer:
    group, views = task
    began = time.perf_counter()
    scenery = None
    if config.pictures:
        scene = config.dataset / config.split / f"{group.scene_id:06d}"
        scenery = Scenery(_features(scene, views, config.scenery), config.scenery)
    registration = register_views(views, catalogue, config.registration, noise, scenery)
    return prediction(group, registration, time.perf_counter() - began)


def _features(scene: Path, views: Sequence[View], config: SceneryConfig) -> dict[Hashable, Features]:
    """Points of each view's picture, by its name.

    Raises:
        DataError: a picture or its camera matrix is not there.
    """
    features: dict[Hashable, Features] = {}
    for view in views:
        path = find_image(scene, ("rgb", "gray"), f"{int(view.view_id):06d}")
        if path is None or view.camera_matrix is None:
            lacking = "picture in rgb/ or gray/" if path is None else "camera matrix in scene_camera.json"
            raise DataError(f"{scene} holds no {lacking} for image {view.view_id}; without --pictures none is needed.")
        image = read_image(path)
        camera = Camera(view.camera_matrix, image.shape[1], image.shape[0])
        features[view.view_id] = find_features(image, camera, config)
    return features


class Summary:
    """Counts answers as they pass."""

    def __init__(self) -> None:
        self._views = self._placed = self._groups = 0
        self._seconds: list[float] = []

    def counting(self, answers: Iterable[Answer]) -> Iterator[Answer]:
        """Yields the answers unchanged."""
        for answer in answers:
            placed = sum(len(component["cameras"]) for component in answer["components"])
            self._groups += 1
            self._placed += placed
            self._views += placed + len(answer["refusals"])
            self._seconds.append(answer["seconds"])
            yield answer

    def text(self) -> str:
        """What came out, in words."""
        milliseconds = 1000 * np.percentile(self._seconds, [50, 95])
        return (
            f"{self._groups} groups answered; {self._placed} of {self._views} views placed, the others refused with a "
            f"reason; {milliseconds[0]:.1f} ms per group (95 % below {milliseconds[1]:.1f} ms)."
        )
