"""Objects of other pictures, pasted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multicam.dataset.bop_reader import read_scene
from multicam.errors import DataError
from tests.train.test_augment import OBJECTS, label, picture
from tests.train.toy_pictures import HEIGHT, WIDTH, toy_picture, write_toy_dataset
from train.augment import Canvas, Zoom, mosaic, warped
from train.collage import Collage, Cutting, draw_cutting, pasted
from train.config import AugmentConfig
from train.samples import Picture, Region, load_picture, project

WHOLE = Region(0, 0, WIDTH, HEIGHT)
AUGMENT = AugmentConfig(rotate_deg=40, shear_deg=5)


def with_instances(seed: int) -> Picture:
    """A toy picture that knows which object each pixel shows."""
    instances = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    for place, row in enumerate(toy_picture(np.random.default_rng(seed)).instances):
        instances[row.mask_visible] = place + 1
    return replace(picture(seed), instances=instances)


def collage(seed: int) -> Collage:
    base = with_instances(seed)
    assert base.instances is not None
    return Collage(Canvas(base.image, label(base, np.eye(3), WHOLE), base.instances.astype(np.uint16)))


def shifted(x: float, y: float) -> np.ndarray:
    return np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]])


def test_a_cutting_is_the_object_without_the_mixed_pixels_of_its_outline() -> None:
    donor = with_instances(1)
    cutting = Cutting.of(donor, 0)
    assert donor.instances is not None
    x, y = cutting.corner.astype(int)
    height, width = cutting.coverage.shape
    mask = donor.instances[y : y + height, x : x + width] == 1
    assert mask.sum() == (donor.instances == 1).sum()
    assert np.all(cutting.coverage[~mask] == 0)
    assert np.all((cutting.coverage > 0) <= mask)
    assert 0.8 * mask.sum() < cutting.coverage.sum() < mask.sum()


def test_a_pasted_object_brings_its_labels_to_where_it_is_drawn() -> None:
    canvas, donor = collage(0), with_instances(1)
    before = len(label(donor, np.eye(3), WHOLE).classes)
    canvas.paste(Cutting.of(donor, 1), shifted(7, -5), label, np.random.default_rng(0))
    labels = canvas.labels(0.1)
    assert len(labels.classes) == before + 1
    own = label(donor, np.eye(3), WHOLE)
    assert np.allclose(labels.keypoints[-1], own.keypoints[1] + (7, -5))
    assert np.allclose(labels.boxes[-1], own.boxes[1] + (7, -5, 7, -5))
    assert labels.classes[-1] == own.classes[1]


@pytest.mark.parametrize("seed", range(4))
def test_the_camera_of_every_pasted_object_maps_its_points_to_its_keypoints(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cuttings = [Cutting.of(with_instances(seed + 1 + i), i % 2) for i in range(3)]
    canvas = warped(with_instances(seed), 192, 160, AUGMENT, rng, label)
    image, labels = pasted(canvas, cuttings, Zoom(192, 160, 0.7, 1.3), AUGMENT, rng, label, 0.1)
    assert image.shape == (160, 192, 3)
    assert len(labels.classes) >= 2
    for row in range(len(labels.classes)):
        assert np.allclose(project(labels.cameras[row], labels.points[row]), labels.keypoints[row], atol=1e-8)


def test_what_is_pasted_on_a_mosaic_hides_objects_of_all_of_its_parts() -> None:
    rng, pictures = np.random.default_rng(0), [with_instances(seed) for seed in range(4)]
    still = replace(AUGMENT, rotate_deg=0, shift=0, shear_deg=0)
    canvas = mosaic(pictures, 2 * WIDTH, 2 * HEIGHT, Zoom(WIDTH, HEIGHT, 1, 1), still, rng, label)
    assert canvas.instances is not None
    assert set(np.unique(canvas.instances)) == {0, *(canvas.labels.places + 1)}
    for row, box in enumerate(canvas.labels.boxes):
        ys, xs = np.nonzero(canvas.instances == canvas.labels.places[row] + 1)
        assert np.all((xs > box[0] - 2) & (xs < box[2] + 2) & (ys > box[1] - 2) & (ys < box[3] + 2)), row
    onto = Collage(canvas)
    before = onto.labels(0.1)
    curtain = Cutting.of(with_instances(5), 0)
    solid = replace(curtain, coverage=np.ones_like(curtain.coverage))
    # So large that nothing else is left to be seen.
    x, y = 99 * solid.middle
    onto.paste(solid, np.array([[99, 0, -x], [0, 99, -y], [0, 0, 1.0]]), label, rng)
    assert not before.ignored.all() and np.all(onto.labels(0.1).seen[:-1] == 0)


def test_what_a_pasted_object_covers_is_hidden() -> None:
    donor = with_instances(0)
    canvas = collage(0)
    before = canvas.labels(0.1)
    # The same object again, exactly over itself: of the old one only the outline is left.
    canvas.paste(Cutting.of(donor, 0), np.eye(3), label, np.random.default_rng(0))
    labels = canvas.labels(0.3)
    assert before.seen[0] == 1 and not before.ignored[0]
    assert labels.seen[0] < 0.3 and labels.ignored[0]
    assert labels.visible[0].sum() < before.visible[0].sum()
    # What lies elsewhere, and what was pasted last, is as visible as before.
    assert labels.seen[1] == 1 and np.array_equal(labels.visible[1], before.visible[1])
    assert labels.seen[2] == 1 and np.array_equal(labels.visible[2], before.visible[0])


def test_later_cuttings_hide_earlier_ones() -> None:
    canvas, donor = collage(0), with_instances(1)
    canvas.paste(Cutting.of(donor, 0), np.eye(3), label, np.random.default_rng(0))
    canvas.paste(Cutting.of(donor, 0), shifted(3, 0), label, np.random.default_rng(0))
    labels = canvas.labels(0.1)
    assert labels.seen[2] < 0.5 < labels.seen[3] == 1


def test_a_cutting_beside_the_canvas_changes_nothing() -> None:
    canvas = collage(0)
    before, labels = canvas.image.copy(), canvas.labels(0.1)
    canvas.paste(Cutting.of(with_instances(1), 0), shifted(10 * WIDTH, 0), label, np.random.default_rng(0))
    assert np.array_equal(canvas.image, before)
    assert len(canvas.labels(0.1).classes) == len(labels.classes)


def test_only_objects_seen_well_enough_are_cut_out() -> None:
    donor = with_instances(0)
    hidden = tuple(replace(instance, visible_fraction=0.3) for instance in donor.record.instances)
    rng = np.random.default_rng(0)
    assert draw_cutting(replace(donor, record=replace(donor.record, instances=hidden)), rng) is None
    drawn = {cutting.place for _ in range(20) if (cutting := draw_cutting(donor, rng))}
    assert drawn == set(range(len(OBJECTS)))


def test_pictures_without_masks_cannot_be_pasted_from(tmp_path: Path) -> None:
    write_toy_dataset(tmp_path, 1)
    (record,) = read_scene(tmp_path / "train" / "000001")
    read = load_picture(record, with_instances=True)
    assert read.instances is not None and set(np.unique(read.instances)) == {0, 1, 2}
    with pytest.raises(DataError, match=r"mask_visib files, which augment\.pasted and, of windows, augment\.bare need"):
        load_picture(replace(record, mask_visib_paths=()), with_instances=True)
