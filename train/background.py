"""Other pictures behind the objects, for data sets whose own pictures stand before black."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from multicam.dataset.bop_reader import IMAGE_SUFFIXES, ImageRecord, read_image, read_mask
from multicam.errors import DataError
from multicam.files import require_folder
from multicam.types import FloatArray
from train.augment import with_background
from train.config import AugmentConfig
from train.samples import Picture, require_masks


class Backgrounds:
    """Pictures of a folder, put behind the objects of a record."""

    def __init__(self, config: AugmentConfig) -> None:
        assert config.backgrounds is not None
        folder = require_folder(config.backgrounds, "folder of backgrounds")
        self.paths = sorted(p for p in folder.rglob("*") if p.suffix.lower() in IMAGE_SUFFIXES)
        self.probability = config.background
        if not self.paths:
            raise DataError(f"{folder} holds no picture ({', '.join(IMAGE_SUFFIXES)}) to use as a background.")

    def behind(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """The picture, with some probability before another background.

        Raises:
            DataError: the data set has neither visible masks nor alpha, or they cannot be read.
        """
        if rng.uniform() >= self.probability:
            return picture
        background = read_image(self.paths[int(rng.integers(len(self.paths)))])
        return replace(picture, image=with_background(picture.image, _alpha(picture.record), background))


def _alpha(record: ImageRecord) -> FloatArray:
    """(h, w) share of each pixel that objects cover, 0..1; hard where the data set has masks only."""
    if record.alpha_path is not None:
        return read_mask(record.alpha_path) / 255
    masks = require_masks(record, "augment.backgrounds needs; leave it out")
    return np.max([read_mask(path) for path in masks], axis=0) / 255
