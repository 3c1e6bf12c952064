"""Pictures as a training step gets them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multicam.dataset.objects import load_catalogue
from multicam.errors import ConfigError
from multicam.progress import SilentProgress
from tests.train.test_collage import with_instances
from tests.train.toy_pictures import HEIGHT, WIDTH, write_toy_dataset
from train.augment import bare_ground
from train.config import AugmentConfig, NetworkConfig, StageConfig
from train.loader import TrainingSet
from train.samples import PictureStore, prepare_objects, project, read_records

WARPED = StageConfig(1, 1e-3, 1e-3)
AS_IT_IS = StageConfig(1, 1e-3, 1e-3, warp=False)


def training_set(folder: Path, network: NetworkConfig, augment: AugmentConfig, pictures: int = 9) -> TrainingSet:
    write_toy_dataset(folder, pictures)
    records = read_records([folder / "train"])
    store = PictureStore(records, False, SilentProgress(), with_instances=True)
    return TrainingSet(store, prepare_objects(load_catalogue(folder / "models"), records, {}), network, augment, 0.1, 0)


def of_windows(width: int = 192, height: int = 160) -> NetworkConfig:
    return NetworkConfig(
        "nano", input_width=2 * width, input_height=2 * height, window_width=width, window_height=height
    )


@pytest.mark.parametrize("stage", [WARPED, AS_IT_IS])
@pytest.mark.parametrize("pasted", [0, 3])
def test_windows_are_learnt_four_at_a_time_in_pictures_of_the_networks_size(
    tmp_path: Path, stage: StageConfig, pasted: int
) -> None:
    network = of_windows()
    pictures = training_set(tmp_path, network, AugmentConfig(pasted=pasted, bare=0.0))
    assert len(pictures) == 2
    image, labels = pictures[0, 1, stage]
    assert image.shape == (320, 384, 3)
    assert len(labels.classes) >= 8 and (labels.boxes[~labels.ignored, 2] > 192).any()
    for row in range(len(labels.classes)):
        assert np.allclose(project(labels.cameras[row], labels.points[row]), labels.keypoints[row], atol=1e-8)


def test_windows_as_they_are_keep_their_size(tmp_path: Path) -> None:
    pictures = training_set(tmp_path, of_windows(), AugmentConfig(pasted=3, mosaic=1.0))
    _, labels = pictures[0, 0, AS_IT_IS]
    fitted = min(192 / WIDTH, 160 / HEIGHT)
    focal = [record.camera_matrix[0, 0] for record in pictures.store.records if record.camera_matrix is not None]
    assert len(labels.classes) == 8
    assert np.allclose(labels.cameras[:, 0, 0], fitted * focal[0])


def test_whole_pictures_are_learnt_one_by_one(tmp_path: Path) -> None:
    network = NetworkConfig("nano", input_width=192, input_height=160)
    pictures = training_set(tmp_path, network, AugmentConfig(mosaic=0.0))
    assert len(pictures) == 9
    assert len(pictures[0, 0, WARPED][1].classes) == len(pictures[0, 0, AS_IT_IS][1].classes) == 2


def test_bare_ground_takes_the_place_of_windows_but_never_of_all(tmp_path: Path) -> None:
    still = {"rotate_deg": 0.0, "shear_deg": 0.0, "shift": 0.0, "cutout": 0.0, "mosaic": 0.0}
    pictures = training_set(tmp_path, of_windows(), AugmentConfig(bare=1.0, pasted=0, **still), pictures=12)
    counts = [len(pictures[epoch, 0, WARPED][1].classes) for epoch in range(12)]
    assert min(counts) == 2 and max(counts) < 8
    pictures.augment = AugmentConfig(bare=0.0, pasted=0, **still)
    assert {len(pictures[epoch, 0, WARPED][1].classes) for epoch in range(12)} == {8}


def test_a_piece_of_bare_ground_shows_no_object() -> None:
    rng, pieces = np.random.default_rng(0), []
    for seed in range(30):
        whole = with_instances(seed)
        pieces.append(bare_ground(whole, rng))
        full = replace(whole, instances=np.ones_like(whole.instances))
        assert bare_ground(full, rng) is None
    found = [piece for piece in pieces if piece is not None]
    assert len(found) > 20
    for piece in found:
        assert not piece.instances.any() and not piece.record.instances
        assert piece.image.shape[:2] == piece.instances.shape
        # The ground of toy pictures is noise about grey; of objects there is an edge at most.
        assert abs(np.median(piece.image) - 110) < 8


def test_windows_too_small_to_fill_a_picture_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"windows of 128 x 160 .* 384 x 320.*camera\.window 0\.5"):
        NetworkConfig("nano", input_width=384, input_height=320, window_width=128, window_height=160)
