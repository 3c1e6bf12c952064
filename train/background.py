"""Other pictures behind the objects, for data sets whose own pictures stand before black."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from multicam.dataset.bop_reader import IMAGE_SUFFIXES, read_image
from multicam.errors import DataError
from multicam.files import require_file, require_folder
from train.augment import with_background
from train.config import AugmentConfig
from train.samples import Picture


class Backgrounds:
    """Pictures of a folder, put behind the visible masks of a record."""

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
            DataError: the data set has no visible masks.
        """
        if rng.uniform() >= self.probability:
            return picture
        masks = picture.record.mask_visib_paths
        if not masks:
            raise DataError(
                f"image {picture.record.im_id} of scene {picture.record.scene_id} has no mask_visib files, "
                "which augment.backgrounds needs; leave that option out."
            )
        objects = np.zeros(picture.image.shape[:2], dtype=np.bool_)
        for path in masks:
            require_file(path, "mask")
            mask = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            if mask is None:
                raise DataError(f"{path} is not a readable mask.")
            objects |= mask > 0
        background = read_image(self.paths[int(rng.integers(len(self.paths)))])
        return replace(picture, image=with_background(picture.image, objects, background))
