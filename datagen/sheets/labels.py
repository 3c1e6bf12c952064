"""Labelled pictures of a split: evenly chosen ones drawn with all their labels, and figures over all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from datagen.sheets.svg import Drawing
from multicam.config import read_yaml
from multicam.dataset.bop_reader import ImageRecord, Instance, list_scenes, read_image, read_scene
from multicam.dataset.objects import Catalogue
from multicam.errors import DataError
from multicam.progress import Progress
from multicam.visualization.overlay import hex_of

SHOWN = 12
"""Pictures of a split on the page."""
_WIDTH = 560
"""Pixels at which small pictures are drawn; larger ones are reduced to it."""
_SEEN = 0.02
"""Objects less visible than this are not drawn; their labels would only hide others."""


@dataclass(frozen=True, eq=False)
class Split:
    """A split as it lies on disk.

    Attributes:
        seed: that its configuration states, or None.
        pictures: of all scenes, in order.
    """

    name: str
    seed: int | None
    scenes: int
    pictures: tuple[ImageRecord, ...]

    @property
    def instances(self) -> list[Instance]:
        """Every labelled object of every picture."""
        return [instance for picture in self.pictures for instance in picture.instances]


@dataclass(frozen=True)
class ShownPicture:
    """One labelled picture on the page."""

    markup: str
    caption: str


def find_splits(folder: Path) -> list[Path]:
    """The split folders of a data set, by name: those with numbered scenes in them."""
    return sorted(p for p in folder.iterdir() if p.is_dir() and any(_is_scene(s) for s in p.iterdir()))


def read_split(path: Path, progress: Progress) -> Split:
    """Reads the labels of all scenes; pixels stay on disk.

    Raises:
        DataError: a scene does not follow the BOP format.
    """
    scenes = [scene for scene in list_scenes(path) if _is_scene(scene)]
    pictures = [
        picture
        for scene in progress.track(scenes, f"reading {path.name}", len(scenes))
        for picture in read_scene(scene)
    ]
    config = path / "config.yaml"
    seed = read_yaml(config).get("seed") if config.is_file() else None
    return Split(path.name, seed, len(scenes), tuple(pictures))


def shown_pictures(split: Split, catalogue: Catalogue, progress: Progress) -> list[ShownPicture]:
    """Pictures spread evenly over the split, drawn with their labels.

    Raises:
        DataError: an image cannot be read.
    """
    count = min(SHOWN, len(split.pictures))
    chosen = np.unique(np.linspace(0, len(split.pictures) - 1, count).round().astype(int)) if count else []
    seed = "" if split.seed is None else f"seed {split.seed}, "
    shown: list[ShownPicture] = []
    for index in progress.track(chosen, f"drawing {split.name}", len(chosen)):
        picture = split.pictures[int(index)]
        caption = f"{seed}scene {picture.scene_id}, image {picture.im_id}"
        shown.append(ShownPicture(_draw(picture, catalogue, caption), caption))
    return shown


def _is_scene(path: Path) -> bool:
    return path.name.isdigit() and (path / "scene_camera.json").is_file()


def _draw(picture: ImageRecord, catalogue: Catalogue, title: str) -> str:
    if picture.rgb_path is None:
        raise DataError(f"scene {picture.scene_id}, image {picture.im_id} has labels but no picture.")
    image = read_image(picture.rgb_path)
    factor = _WIDTH / image.shape[1]
    method = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    height = round(image.shape[0] * factor)
    drawing = Drawing(_WIDTH, height, title)
    drawing.picture(
        cv2.resize(image, (_WIDTH, height), interpolation=method).astype(np.uint8, copy=False), _WIDTH, height
    )
    for index, instance in enumerate(picture.instances):
        if instance.visible_fraction is None or instance.visible_fraction >= _SEEN:
            _draw_instance(drawing, picture, index, factor, catalogue, height)
    return drawing.markup()


def _draw_instance(
    drawing: Drawing, picture: ImageRecord, index: int, factor: float, catalogue: Catalogue, height: int
) -> None:
    instance = picture.instances[index]
    color = hex_of(instance.obj_id)
    shift = (factor - 1) / 2
    if picture.mask_visib_paths:
        mask = read_image(picture.mask_visib_paths[index])[..., 0]
        contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_TC89_L1)
        drawing.outline([c[:, 0].astype(np.float64) * factor + shift for c in contours if len(c) > 1], color, 1.4)
    if instance.keypoints is not None and instance.keypoints_visible is not None:
        for point, visible in zip(instance.keypoints, instance.keypoints_visible, strict=True):
            drawing.dot(point * factor + shift, 2.4, color if visible else "none", "#000" if visible else color)
    if instance.box is not None:
        box = instance.box * factor + shift
        drawing.rectangle(box, color, 1.0, dash="5 4")
        name = catalogue[instance.obj_id].name if instance.obj_id in catalogue else f"class {instance.obj_id}"
        place = np.clip(np.add(box[:2], (2, -3)), [2, 11], [_WIDTH - 60, height - 4])
        drawing.text(place, name.replace("_", " "), 11, "#1d2430", bold=True)


def count_of_classes(splits: Sequence[Split], catalogue: Catalogue) -> dict[str, dict[str, tuple[int, int]]]:
    """By split and class: labelled objects, and those of which at least a tenth is visible."""
    found: dict[str, dict[str, tuple[int, int]]] = {}
    for split in splits:
        rows = found.setdefault(split.name, {})
        for obj_id in catalogue.obj_ids:
            of_class = [i for i in split.instances if i.obj_id == obj_id]
            visible = sum(i.visible_fraction is None or i.visible_fraction >= 0.1 for i in of_class)
            rows[catalogue[obj_id].name] = len(of_class), visible
    return found
