"""The contact sheets of docs/images from rendered data.

    python scripts/contact_sheets.py --data DATA_SET --recordings RECORDING [RECORDING ...] [--output docs/images]

DATA_SET is the output of `multicam datagen render` with assemblies.json among its models, the recordings are those of
`multicam datagen sequence`. Nothing is rendered; pictures are chosen evenly, or by what they show.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from datagen.recordings.config import DepthConfig
from datagen.recordings.depth_sensor import sense_depth
from datagen.scenes.stock import Group, Stock, load_stock
from multicam.config import load_config
from multicam.dataset.bop_reader import ImageRecord, list_scenes, read_depth, read_image, read_mask, read_scene
from multicam.dataset.objects import Catalogue, load_catalogue
from multicam.dataset.sequence import load_recording
from multicam.files import write_bytes
from multicam.geometry import se3
from multicam.progress import SilentProgress
from multicam.spread import spread
from multicam.types import ImageArray
from train.augment import with_background
from train.config import TrainConfig
from train.loader import TrainingSet
from train.samples import PictureStore, prepare_objects

WIDTH = 240
"""Of one picture, pixels."""
COLORS = [(255, 190, 0), (0, 200, 255), (120, 255, 120), (255, 120, 220), (255, 255, 255)]


def main() -> None:
    """Reads the flags, writes the sheets."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--split", default="train")
    parser.add_argument("--recordings", type=Path, nargs="+", required=True)
    parser.add_argument("--output", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    records = [record for scene in list_scenes(options.data / options.split) for record in read_scene(scene)]
    stock = load_stock(options.data / "models")
    sheets = {
        "randomised": [labelled(record) for record in spread(records, 24)],
        "assembled": [labelled(record) for record in spread([r for r in records if is_assembled(r, stock)], 12)],
        "compositing": composed(spread(records, 60), load_catalogue(options.data)),
        "depth": [tile for record in spread(records, 4) for tile in sensed(record)],
        "recordings": [tile for folder in options.recordings for tile in filmed(folder)],
    }
    for name, tiles in sheets.items():
        columns = 4 if name in ("depth", "compositing") else 6
        done, data = cv2.imencode(".jpg", sheet(tiles, columns)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])
        assert done
        write_bytes(options.output / f"datagen-{name}.jpg", data.tobytes())


def sheet(tiles: Sequence[ImageArray], columns: int) -> ImageArray:
    """Tiles of one width in rows."""
    height = max(tile.shape[0] for tile in tiles)
    blank = np.zeros((height, WIDTH, 3), np.uint8)
    filled = [np.vstack((tile, blank[: height - len(tile)])) for tile in tiles]
    filled += [blank] * (-len(tiles) % columns)
    return np.vstack([np.hstack(filled[i : i + columns]) for i in range(0, len(filled), columns)])


def small(image: ImageArray, caption: str = "") -> ImageArray:
    """A tile."""
    made = cv2.resize(image, (WIDTH, round(WIDTH * image.shape[0] / image.shape[1])), interpolation=cv2.INTER_AREA)
    for color, thickness in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(made, caption, (5, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, color, thickness, cv2.LINE_AA)
    return made


def picture_of(record: ImageRecord) -> ImageArray:
    """The pixels of a record."""
    assert record.rgb_path is not None
    return read_image(record.rgb_path)


def labelled(record: ImageRecord) -> ImageArray:
    """The picture with visible outlines and visible keypoints."""
    image = np.repeat(np.repeat(picture_of(record), 2, axis=0), 2, axis=1)
    for number, (instance, path) in enumerate(zip(record.instances, record.mask_visib_paths, strict=True)):
        color = COLORS[number % len(COLORS)]
        mask = np.repeat(np.repeat(read_mask(path), 2, axis=0), 2, axis=1)
        outline, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, outline, -1, color, 1)
        if instance.keypoints is not None and instance.keypoints_visible is not None:
            for x, y in 2 * instance.keypoints[instance.keypoints_visible] + 0.5:
                cv2.circle(image, (round(x), round(y)), 3, color, -1, cv2.LINE_AA)
    return small(image)


def is_assembled(record: ImageRecord, stock: Stock) -> bool:
    """Whether three parts of a group or more are well seen, each where the group has it."""
    seen = {i.obj_id: i.camera_from_object for i in record.instances if (i.visible_fraction or 0) > 0.3}
    return any(_is_mounted(group, seen) for group in stock.groups)


def _is_mounted(group: Group, seen: dict[int, NDArray[np.float64]]) -> bool:
    places = [seen[i] @ se3.inverse(group_from_object) for i, group_from_object in group.parts if i in seen]
    return len(places) > 2 and all(np.allclose(place, places[0], atol=1e-4) for place in places)


def composed(records: Sequence[ImageRecord], catalogue: Catalogue) -> list[ImageArray]:
    """Rows of a picture, its alpha, its objects before another ground, and what the trainer makes of it."""
    config = load_config(TrainConfig, Path("configs/train/instruments.yaml"))
    objects, store = prepare_objects(catalogue, records, {}), PictureStore(records, False, SilentProgress(), True)
    trained = TrainingSet(store, objects, config.network, config.augment, config.minimum_visible, 0)
    alphas = [read_mask(record.alpha_path) for record in records if record.alpha_path is not None]
    emptiest = int(np.argmin([alpha.mean() for alpha in alphas]))
    covered = cv2.dilate((alphas[emptiest] > 0).astype(np.uint8), np.ones((9, 9), np.uint8))
    plain = cv2.inpaint(picture_of(records[emptiest]), covered, 5, cv2.INPAINT_TELEA).astype(np.uint8)
    tiles: list[ImageArray] = []
    for index in spread(range(len(records)), 6):
        image, alpha = picture_of(records[index]), alphas[index]
        pasted, labels = trained[0, index, config.stages.first]
        for box, points, visible in zip(labels.boxes, labels.keypoints, labels.visible, strict=True):
            (x0, y0), (x1, y1) = np.rint(box).astype(int).reshape(2, 2).tolist()
            cv2.rectangle(pasted, (x0, y0), (x1, y1), COLORS[1], 1)
            for x, y in np.rint(points[visible]).astype(int).tolist():
                cv2.circle(pasted, (x, y), 2, COLORS[0], -1, cv2.LINE_AA)
        grey = np.repeat(alpha[..., None], 3, axis=2)
        row = (image, grey, with_background(image, alpha / 255, plain), pasted)
        names = ("picture", "alpha", "another background", "in training, with labels")
        tiles += [small(tile, name) for tile, name in zip(row, names, strict=True)]
    return tiles


def sensed(record: ImageRecord) -> list[ImageArray]:
    """The picture, exact depth, what a depth camera would give, and its error."""
    assert record.depth_path is not None
    image, exact = picture_of(record), read_depth(record.depth_path, record.depth_scale)
    given = sense_depth(exact, image, DepthConfig(), np.random.default_rng(0))
    span = np.percentile(exact[exact > 0], [2, 98])
    error = np.where((given > 0) & (exact > 0), 0.5 + (given - exact) / 0.01, 0)
    tiles = (image, _colored(exact, *span), _colored(given, *span), _colored(error, 0, 1, known=given > 0))
    names = ("picture", f"depth, {span[0]:.2f} to {span[1]:.2f} m", "as sensed (black: none)", "error, -5 to 5 mm")
    return [small(tile, name) for tile, name in zip(tiles, names, strict=True)]


def _colored(
    values: NDArray[np.floating], low: float, high: float, known: NDArray[np.bool_] | None = None
) -> ImageArray:
    level = np.clip((values - low) / (high - low), 0, 1) * 255
    shown = cv2.applyColorMap(level.astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1]
    return np.where((values > 0 if known is None else known)[..., None], shown, 0).astype(np.uint8)


def filmed(folder: Path) -> list[ImageArray]:
    """Two pictures of each camera of a recording."""
    recording = load_recording(folder)
    tiles: list[ImageArray] = []
    for camera in recording.cameras:
        for entry in (camera.frames[len(camera.frames) // 8], camera.frames[5 * len(camera.frames) // 8]):
            image = recording.load_frame(camera, entry).image
            tiles.append(small(image, f"{folder.name}: {camera.camera_id}, {entry.timestamp_ns / 1e9:.1f} s"))
    return tiles


if __name__ == "__main__":
    main()
