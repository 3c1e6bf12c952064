from dataclasses import replace

import numpy as np
import pytest

from multicam.dataset.bop_reader import ImageRecord, Instance
from multicam.geometry import se3, so3
from tests.train.toy_pictures import HEIGHT, WIDTH, toy_objects, toy_picture
from train.augment import Photometry, Zoom, cutout, letterboxed, mosaic, warped, with_background
from train.config import AugmentConfig
from train.samples import (
    Labels,
    Picture,
    Region,
    TrainedObject,
    make_labels,
    outline_points,
    project,
    split_roll,
)
from train.symmetry import canonical_view


def objects() -> dict[int, TrainedObject]:
    catalogue, meshes = toy_objects()
    known = {}
    for index, (obj_id, model) in enumerate(catalogue.objects.items()):
        vertices = meshes[obj_id].vertices
        view = canonical_view(
            model, se3.from_parts(so3.random(np.random.default_rng(0), 9), np.tile([0, 0, 1.0], (9, 1)))
        )
        known[obj_id] = TrainedObject(index, model, model.keypoints, outline_points(vertices), vertices, view)
    return known


OBJECTS = objects()


def picture(seed: int = 0) -> Picture:
    made = toy_picture(np.random.default_rng(seed))
    instances = tuple(
        Instance(row.obj_id, row.camera_from_object, row.box, row.visible_fraction) for row in made.instances
    )
    record = ImageRecord(1, seed, made.camera.matrix, None, 1.0, None, None, (), instances)
    return Picture(record, made.image, None)


def label(of: Picture, affine: np.ndarray, region: Region) -> Labels:
    return make_labels(of, OBJECTS, affine, region, 0.1)


AUGMENT = AugmentConfig(rotate_deg=40, shear_deg=5)


def test_labels_of_an_untouched_picture_are_those_of_the_record() -> None:
    made = picture()
    labels = label(made, np.eye(3), Region(0, 0, WIDTH, HEIGHT))
    for row, instance in enumerate(made.record.instances):
        assert instance.box is not None
        assert np.allclose(labels.boxes[row], instance.box, atol=1e-6)
        assert labels.classes[row] == OBJECTS[instance.obj_id].index
    # The brick has no symmetry: its pose stays.
    assert np.allclose(labels.poses[0], made.record.instances[0].camera_from_object)


@pytest.mark.parametrize("seed", range(4))
def test_the_camera_of_a_warped_picture_maps_its_points_to_its_keypoints(seed: int) -> None:
    canvas = warped(picture(seed), 192, 160, AUGMENT, np.random.default_rng(seed), label)
    assert canvas.image.shape == (160, 192, 3) and canvas.instances is None
    labels = canvas.labels
    for row in range(len(labels.classes)):
        assert np.allclose(project(labels.cameras[row], labels.points[row]), labels.keypoints[row], atol=1e-8)
        assert np.allclose(
            se3.act(labels.poses[row], OBJECTS[(2, 5)[labels.classes[row]]].keypoints), labels.points[row]
        )
        assert np.allclose(np.tril(labels.cameras[row], -1), 0, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_keypoints_go_where_the_warp_takes_their_pixels(seed: int) -> None:
    made = picture(seed)
    assert made.record.camera_matrix is not None
    angle = np.deg2rad(70)
    affine = np.array([[1.2 * np.cos(angle), -np.sin(angle), 90], [1.2 * np.sin(angle), np.cos(angle), -20], [0, 0, 1]])
    labels = label(made, affine, Region(0, 0, WIDTH, HEIGHT))
    brick = made.record.instances[0].camera_from_object
    before = project(made.record.camera_matrix, se3.act(brick, OBJECTS[2].keypoints))
    assert np.allclose(before @ affine[:2, :2].T + affine[:2, 2], labels.keypoints[0], atol=1e-7)


def test_labels_of_a_symmetric_object_are_chosen_after_the_warp() -> None:
    # The plate lies flat before the camera; turned half round it looks as before, so its labels stay where they are.
    made = picture()
    flat = Instance(5, se3.from_parts(np.eye(3), np.array([0, 0, 0.5])), None, 1.0)
    made = Picture(replace(made.record, instances=(flat,)), made.image, None)
    region = Region(0, 0, WIDTH, HEIGHT)
    half = np.array([[-1.0, 0, WIDTH - 1], [0, -1.0, HEIGHT - 1], [0, 0, 1]])
    straight, turned = label(made, np.eye(3), region), label(made, half, region)
    assert np.allclose(turned.keypoints, straight.keypoints, atol=1e-6)
    # A shift keeps the choice, and the labels move with the pixels.
    shifted = label(made, np.array([[1.0, 0, 7], [0, 1, 3], [0, 0, 1]]), region)
    assert np.allclose(shifted.keypoints, straight.keypoints + np.array([7, 3]))


def test_pixels_and_labels_of_a_warp_agree() -> None:
    # A white square in the middle of a grey picture, warped: its centre of mass is where the map says.
    made = picture()
    canvas = np.full((HEIGHT, WIDTH, 3), 114, dtype=np.uint8)
    canvas[60:67, 70:77] = 255
    seen: list[np.ndarray] = []

    def remember(of: Picture, affine: np.ndarray, region: Region) -> Labels:
        seen.append(affine)
        return label(of, affine, region)

    drawn = warped(Picture(made.record, canvas, None), 192, 160, AUGMENT, np.random.default_rng(5), remember)
    weight = drawn.image[..., 0].astype(float) - 114
    ys, xs = np.mgrid[0:160, 0:192]
    found = np.array([(weight * xs).sum(), (weight * ys).sum()]) / weight.sum()
    assert np.allclose(found, seen[0][:2, :2] @ (73, 63) + seen[0][:2, 2], atol=0.3)


def test_tiles_of_a_mosaic_have_cameras_of_their_own() -> None:
    zoom = Zoom(192, 160, 0.5, 1.0)
    canvas = mosaic([picture(i) for i in range(4)], 192, 160, zoom, AUGMENT, np.random.default_rng(0), label)
    labels = canvas.labels
    assert canvas.image.shape == (160, 192, 3) and len(labels.classes) == 8
    assert len(np.unique(labels.cameras.round(6), axis=0)) == 4
    for row in range(8):
        assert np.allclose(project(labels.cameras[row], labels.points[row]), labels.keypoints[row], atol=1e-8)


def test_instances_cut_off_by_their_tile_are_ignored() -> None:
    made = picture()
    gone = np.array([[1.0, 0, 400], [0, 1, 0], [0, 0, 1]])
    assert label(made, gone, Region(0, 0, WIDTH, HEIGHT)).ignored.all()
    assert not label(made, np.eye(3), Region(0, 0, WIDTH, HEIGHT)).ignored.any()


def test_the_depth_image_hides_keypoints_behind_others() -> None:
    made = picture()
    wall = np.full((HEIGHT, WIDTH), 0.1, dtype=np.float32)
    region = Region(0, 0, WIDTH, HEIGHT)
    behind = make_labels(Picture(made.record, made.image, wall), OBJECTS, np.eye(3), region, 0.1)
    inside = region.contains(behind.keypoints)
    assert not behind.visible[inside].any()
    unknown = make_labels(Picture(made.record, made.image, 0 * wall), OBJECTS, np.eye(3), region, 0.1)
    assert unknown.visible[inside].all()


def test_patches_hide_the_keypoints_under_them() -> None:
    rng = np.random.default_rng(2)
    image, labels = letterboxed(picture(), 192, 160, label)
    before = labels.visible.sum()
    donor = np.full((50, 50, 3), 7, dtype=np.uint8)
    for _ in range(30):
        image, labels = cutout(image, labels, donor, rng)
    assert labels.visible.sum() < before
    for x, y in labels.keypoints[labels.visible]:
        # A hidden pixel has the donor's colour.
        assert tuple(image[round(y), round(x)]) != (7, 7, 7)


def test_the_background_changes_only_behind_the_objects() -> None:
    image, mask = np.full((4, 4, 3), 9, dtype=np.uint8), np.eye(4, dtype=bool)
    out = with_background(image, mask.astype(float), np.full((8, 8, 3), 50, dtype=np.uint8))
    assert (out[mask] == 9).all() and (out[~mask] == 50).all()


def test_an_edge_keeps_nothing_of_the_old_background() -> None:
    """The pixel in the middle is half object (100), half old background (0), half new one (200) afterwards."""
    image = np.repeat(np.array([[100, 100, 50, 0, 0]], dtype=np.uint8)[..., None], 3, axis=2)
    out = with_background(image, np.array([[1, 1, 0.5, 0, 0]]), np.full((1, 5, 3), 200, dtype=np.uint8))
    assert out[0, :, 0].tolist() == [100, 100, 150, 200, 200]


def test_a_picture_without_objects_is_all_background() -> None:
    background = np.full((4, 4, 3), 50, dtype=np.uint8)
    assert np.array_equal(with_background(np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4)), background), background)


def test_photometry_repeats_itself_for_the_same_generator() -> None:
    photometry = Photometry(AugmentConfig(blur=1, noise=1, jpeg=1))
    image = picture().image
    first = photometry(image, np.random.default_rng(3))
    assert np.array_equal(first, photometry(image, np.random.default_rng(3)))
    assert not np.array_equal(first, photometry(image, np.random.default_rng(4)))
    assert first.shape == image.shape and first.dtype == np.uint8


def test_rq_split_gives_an_upright_camera_and_a_rotation() -> None:
    rng = np.random.default_rng(0)
    camera = np.array([[300.0, 1, 160], [0, 310, 120], [0, 0, 1]])
    affine = np.eye(3)
    affine[:2] += rng.normal(size=(2, 3))
    upright, turn = split_roll(affine @ camera)
    assert np.allclose(upright @ turn[:3, :3], affine @ camera)
    assert np.allclose(turn[:3, :3] @ turn[:3, :3].T, np.eye(3)) and np.linalg.det(turn) > 0
    assert np.all(np.diag(upright) > 0)
