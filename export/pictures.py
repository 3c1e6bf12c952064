"""Pictures to compare on, with their truth where they come from a BOP split."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from multicam.dataset.bop_reader import IMAGE_SUFFIXES, ImageRecord, list_scenes, read_image, read_scene
from multicam.errors import DataError
from multicam.files import require_folder
from multicam.spread import spread
from multicam.types import ImageArray


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture.

    Attributes:
        image: (h, w, 3) uint8 RGB.
        record: what a BOP split says of it, or None.
    """

    image: ImageArray
    record: ImageRecord | None = None


def read_pictures(folder: Path, most: int) -> list[Picture]:
    """At most so many pictures, spread over a BOP split or over a folder with its subfolders.

    Raises:
        DataError: no folder, no pictures, or a damaged one.
    """
    require_folder(folder, "folder of pictures")
    if any(folder.glob("*/scene_camera.json")):
        return read_split(folder, most)
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in IMAGE_SUFFIXES)
    if not paths:
        raise DataError(f"{folder} holds no pictures ({', '.join(IMAGE_SUFFIXES)}).")
    return [Picture(read_image(path)) for path in spread(paths, most)]


def read_split(folder: Path, most: int) -> list[Picture]:
    """At most so many pictures, spread over a BOP split.

    Raises:
        DataError: no split, no pictures, or a damaged one.
    """
    records = [record for scene in list_scenes(folder) for record in read_scene(scene)]
    paths = {record: record.rgb_path for record in records if record.rgb_path is not None}
    if not paths:
        raise DataError(f"{folder} holds no pictures in its scenes (rgb or gray folders).")
    return [Picture(read_image(path), record) for record, path in spread(list(paths.items()), most)]
