"""Batches in an order, and with an augmentation, that depend on seed, epoch and index alone."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from multicam.types import ImageArray
from train.augment import Photometry, Zoom, bare_ground, cutout, letterboxed, mosaic, warped
from train.background import Backgrounds
from train.collage import Cutting, draw_cutting, pasted
from train.config import WINDOWS, AugmentConfig, NetworkConfig, StageConfig
from train.samples import Labels, Picture, PictureStore, TrainedObject, make_labels


class Batch(NamedTuple):
    """Pictures and their labels, padded to the most instances G of the batch.

    Attributes:
        images: (B, 3, H, W) uint8.
        classes: (B, G) int64; boxes: (B, G, 4); keypoints: (B, G, K, 2) pixels.
        visible: (B, G, K) 0 or 1.
        points: (B, G, K, 3) metres; cameras: (B, G, 3, 3); diameters: (B, G) metres.
        learnt: (B, G) bool, instances to learn; ignored: (B, G) bool, instances that are no background either.
    """

    images: Tensor
    classes: Tensor
    boxes: Tensor
    keypoints: Tensor
    visible: Tensor
    points: Tensor
    cameras: Tensor
    diameters: Tensor
    learnt: Tensor
    ignored: Tensor

    def to(self, device: torch.device) -> Batch:
        """The batch on a device."""
        return Batch(*(t.to(device, non_blocking=True) for t in self))


Place = tuple[int, int, StageConfig]
"""Epoch, index of the picture, the stage that says how large it is and whether it is warped."""


_MOSAIC_SCALE = (0.5, 1.0)
"""Least and greatest zoom of the four parts of a mosaic of whole pictures."""

_AS_THEY_ARE = AugmentConfig(mosaic=0.0, bare=0.0, rotate_deg=0.0, shift=0.0, scale=(1.0, 1.0), shear_deg=0.0)


class TrainingSet(Dataset[tuple[ImageArray, Labels]]):
    """Augmented pictures; the item (epoch, index, stage) is always the same.

    Windows are put together to pictures of the size that the network will see. From single ones it learns to lean on
    their borders, which are never far, and finds objects on bare ground where they are (docs/training.md).
    """

    def __init__(
        self,
        store: PictureStore,
        objects: dict[int, TrainedObject],
        network: NetworkConfig,
        augment: AugmentConfig,
        minimum_visible: float,
        seed: int,
    ) -> None:
        self.store, self.augment, self.seed = store, augment, seed
        self.network = network
        self.minimum_visible = minimum_visible
        self.label = partial(_label, objects, minimum_visible)
        self.photometry = Photometry(augment)
        self.backgrounds = Backgrounds(augment) if augment.backgrounds else None

    def __len__(self) -> int:
        return max(len(self.store) // WINDOWS, 1) if self.network.windows else len(self.store)

    def __getitem__(self, place: Place) -> tuple[ImageArray, Labels]:
        epoch, index, stage = place
        network = self.network.scaled(stage.scale)
        rng = np.random.default_rng((self.seed, epoch, index))
        if stage.warp or network.windows:
            image, labels = self._composed(index, network, stage.warp, rng)
        else:
            image, labels = letterboxed(self._picture(index, rng), *network.input_size, self.label)
        if stage.warp and rng.uniform() < self.augment.cutout:
            donor = self.store[int(rng.integers(len(self.store)))].image
            image, labels = cutout(image, labels, donor, rng)
        return self.photometry(image, rng), labels

    def _composed(
        self, index: int, network: NetworkConfig, warp: bool, rng: np.random.Generator
    ) -> tuple[ImageArray, Labels]:
        config = self.augment if warp else _AS_THEY_ARE
        size, zoom, indices = network.input_size, Zoom(*network.window_size, *config.scale), [index]
        if network.windows:
            indices = rng.integers(len(self.store), size=WINDOWS).tolist()
        elif rng.uniform() < config.mosaic:
            indices += rng.integers(len(self.store), size=3).tolist()
            zoom = Zoom(*size, *_MOSAIC_SCALE)
        pictures = [self._picture(i, rng) for i in indices]
        if network.windows and config.bare:
            pictures = self._with_ground(pictures, rng)
        if len(pictures) > 1:
            canvas = mosaic(pictures, *size, zoom, config, rng, self.label)
        else:
            canvas = warped(pictures[0], *size, config, rng, self.label)
        if not config.pasted:
            return canvas.image, canvas.labels
        return pasted(canvas, self._cuttings(len(pictures), rng), zoom, config, rng, self.label, self.minimum_visible)

    def _with_ground(self, windows: list[Picture], rng: np.random.Generator) -> list[Picture]:
        """Windows of which some, but never all, have given way to a piece of their ground."""
        pictures = windows.copy()
        for place in range(1, len(pictures)):
            if rng.uniform() < self.augment.bare:
                pictures[place] = bare_ground(windows[place], rng) or windows[place]
        return [pictures[place] for place in rng.permutation(len(pictures))]

    def _cuttings(self, pictures: int, rng: np.random.Generator) -> list[Cutting]:
        donors = rng.integers(len(self.store), size=int(rng.integers(self.augment.pasted * pictures + 1)))
        return [cutting for i in donors if (cutting := draw_cutting(self.store[int(i)], rng))]

    def _picture(self, index: int, rng: np.random.Generator) -> Picture:
        picture = self.store[index]
        return self.backgrounds.behind(picture, rng) if self.backgrounds else picture


class ValidationSet(Dataset[tuple[ImageArray, Labels]]):
    """Pictures as the runtime sees them."""

    size: tuple[int, int]
    """Width and height of the pictures; a stage of smaller ones sets its own."""

    def __init__(
        self,
        store: PictureStore,
        objects: dict[int, TrainedObject],
        network: NetworkConfig,
        minimum_visible: float,
    ) -> None:
        self.store = store
        self.size = network.input_width, network.input_height
        self.label = partial(_label, objects, minimum_visible)

    def __len__(self) -> int:
        return len(self.store)

    def __getitem__(self, index: int) -> tuple[ImageArray, Labels]:
        return letterboxed(self.store[index], *self.size, self.label)


class EpochSampler(Sampler[list[Place]]):
    """Batches of one epoch for one process; every process of a step together takes one run of the shuffled order."""

    def __init__(self, count: int, batch_size: int, seed: int, rank: int = 0, processes: int = 1) -> None:
        self.count, self.batch_size, self.seed = count, batch_size, seed
        self.rank, self.processes = rank, processes
        self._epoch, self._first, self._stage = 0, 0, StageConfig(1, 1.0, 1.0)

    def set_epoch(self, epoch: int, first_step: int, stage: StageConfig) -> None:
        """Chooses what the next iteration yields: an epoch of a stage from a step on."""
        self._epoch, self._first, self._stage = epoch, first_step, stage

    def __len__(self) -> int:
        """Steps of a whole epoch; a last, smaller step is kept only when it is the only one."""
        return max(self.count // (self.batch_size * self.processes), 1)

    def __iter__(self) -> Iterator[list[Place]]:
        order = np.random.default_rng((self.seed, self._epoch)).permutation(self.count)
        each = self.batch_size * self.processes
        for step in range(self._first, len(self)):
            mine = order[step * each : (step + 1) * each][self.rank :: self.processes]
            yield [(self._epoch, int(index), self._stage) for index in mine]


def training_loader(dataset: TrainingSet, sampler: EpochSampler, workers: int) -> DataLoader[Batch]:
    """Batches of the epoch that the sampler is set to."""
    # A generator of its own: opening a loader must not draw from the numbers that a resumed run goes on with.
    return DataLoader(
        dataset,
        batch_sampler=sampler,
        num_workers=workers,
        collate_fn=collate,
        worker_init_fn=_ignore_signals,
        generator=torch.Generator(),
    )


def collate(samples: Sequence[tuple[ImageArray, Labels]]) -> Batch:
    """Pads the labels of several pictures to the same number of instances."""
    images = torch.from_numpy(np.stack([image for image, _ in samples])).permute(0, 3, 1, 2)
    labels = [label for _, label in samples]
    most = max(1, *(len(label.classes) for label in labels))

    def padded(arrays: list[NDArray[np.generic]], dtype: torch.dtype) -> Tensor:
        out = torch.zeros((len(arrays), most, *arrays[0].shape[1:]), dtype=dtype)
        for row, array in zip(out, arrays, strict=True):
            row[: len(array)] = torch.from_numpy(array)
        return out

    cameras = padded([label.cameras for label in labels], torch.float32)
    # Padding must stay invertible.
    cameras[(cameras == 0).all(dim=(2, 3))] = torch.eye(3)
    return Batch(
        images,
        padded([label.classes for label in labels], torch.int64),
        padded([label.boxes for label in labels], torch.float32),
        padded([label.keypoints for label in labels], torch.float32),
        padded([label.visible for label in labels], torch.float32),
        padded([label.points for label in labels], torch.float32),
        cameras,
        padded([label.diameters for label in labels], torch.float32),
        padded([~label.ignored for label in labels], torch.bool),
        padded([label.ignored for label in labels], torch.bool),
    )


def _ignore_signals(worker: int) -> None:
    """Ctrl-C reaches the whole process group; the training process decides when its loaders end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)


def _label(objects: dict[int, TrainedObject], minimum_visible: float, picture: Picture, affine, region) -> Labels:
    return make_labels(picture, objects, affine, region, minimum_visible)
