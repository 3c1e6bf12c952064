"""An exact small world: invented objects on a table, cameras around it, estimates with noise of one's choice.

Without noise every estimate is the truth times a random symmetry of the object, so a registration must return
the truth to rounding. `make_world` gives cameras of one moment; tests/toy_walk.py adds time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from multicam.dataset.objects import Catalogue, ObjectModel
from multicam.geometry import se3, so3
from multicam.geometry.camera import Camera
from multicam.geometry.symmetry import symmetric_distance
from multicam.types import Component, Detection, ObjectEstimate, View
from tests.toy_objects import BRACKET, PEG, PLATE, PYRAMID, ROD, WEDGE, random_symmetry, toy_catalogue

FloatArray = NDArray[np.float64]

ALL_CLASSES = (BRACKET, PLATE, PEG, ROD, PYRAMID, WEDGE)
CAMERA = Camera.from_focal(600.0, 640, 480)

ROTATION_FLOOR, TRANSLATION_FLOOR, PIXEL_FLOOR = 2e-3, 5e-4, 0.5
"""Least standard deviations (rad, m, px) that an estimate claims, however exact it is."""


@dataclass(frozen=True, eq=False)
class ToyObject:
    """One object on the table."""

    obj_id: int
    world_from_object: FloatArray


@dataclass(frozen=True, eq=False)
class ToyCamera:
    """One camera and the indices of the objects it sees."""

    camera_id: str
    world_from_camera: FloatArray
    visible: tuple[int, ...]
    camera: Camera = CAMERA


@dataclass(frozen=True, eq=False)
class ToyWorld:
    """Cameras and objects with known poses in one world."""

    catalogue: Catalogue
    cameras: tuple[ToyCamera, ...]
    objects: tuple[ToyObject, ...]

    @property
    def world_from_camera(self) -> dict[str, FloatArray]:
        """True camera poses by camera_id."""
        return {c.camera_id: c.world_from_camera for c in self.cameras}

    def views(
        self,
        rng: np.random.Generator,
        rotation_noise: float = 0.0,
        translation_noise: float = 0.0,
        outlier_fraction: float = 0.0,
        symmetric_twins: bool = True,
        with_detections: bool = True,
        keypoint_noise: float = 0.0,
    ) -> tuple[View, ...]:
        """One View per camera; estimates in order of falling score, not of objects.

        Args:
            rotation_noise, translation_noise: standard deviation per axis (rad, m) of the right perturbation;
                the covariance of the estimate states them (with a floor).
            outlier_fraction: probability that an estimate of the right class stands wholly elsewhere.
            symmetric_twins: multiply each pose by a random symmetry of its object.
            with_detections: add keypoints: those of the pose before its noise, plus `keypoint_noise` px per axis.
        """
        return tuple(
            self._view(
                camera, rng, (rotation_noise, translation_noise), outlier_fraction, symmetric_twins,
                keypoint_noise if with_detections else None,
            )
            for camera in self.cameras
        )  # fmt: skip

    def _view(
        self, camera: ToyCamera, rng: np.random.Generator, noise: tuple[float, float], outlier_fraction: float,
        twins: bool, keypoint_noise: float | None,
    ) -> View:  # fmt: skip
        spread = np.repeat(noise, 3)
        covariance = np.diag(np.maximum(spread, np.repeat((ROTATION_FLOOR, TRANSLATION_FLOOR), 3)) ** 2)
        estimates: list[ObjectEstimate] = []
        for index in camera.visible:
            model = self.catalogue[self.objects[index].obj_id]
            world_from_object = self.objects[index].world_from_object
            if rng.uniform() < outlier_fraction:
                world_from_object = misplaced(world_from_object, rng)
            pose = se3.inverse(camera.world_from_camera) @ world_from_object
            if twins:
                pose = pose @ random_symmetry(model.symmetries, rng)
            score = float(rng.uniform(0.5, 1.0))
            found = None
            if keypoint_noise is not None:
                found = detect(camera.camera, pose, self.catalogue, model.obj_id, score, keypoint_noise, rng)
            noisy = se3.plus(pose, spread * rng.normal(size=6))
            estimates.append(ObjectEstimate(model.obj_id, score, noisy, covariance, found))
        ordered = sorted(estimates, key=lambda estimate: -estimate.score)
        return View(camera.camera_id, tuple(ordered), camera.camera.matrix)


def make_world(
    rng: np.random.Generator,
    num_cameras: int = 3,
    classes: Iterable[int] = ALL_CLASSES,
    chain: bool = False,
) -> ToyWorld:
    """Cameras on an arc of 120 degrees, about 0.9 m from a table with one object per entry of `classes`.

    Repeat a class for several instances of it. With `chain`, the classes are laid out once for each pair of
    neighbouring cameras, and only that pair sees them: the first and the last camera then share no object.
    """
    classes = tuple(classes)
    links = num_cameras - 1 if chain else 1
    objects = place_objects(rng, classes * links)
    cameras: list[ToyCamera] = []
    for index, azimuth in enumerate(np.linspace(-np.pi / 3, np.pi / 3, num_cameras)):
        seen = [i for i in range(len(objects)) if not chain or index - 1 <= i // len(classes) <= index]
        radius = rng.uniform(0.85, 0.95)
        eye = radius * np.array([np.sin(azimuth) * 0.7, -np.cos(azimuth) * 0.7, 0.7])
        cameras.append(ToyCamera(f"camera{index}", looking_at(eye, rng.normal(scale=0.02, size=3)), tuple(seen)))
    return ToyWorld(toy_catalogue(), tuple(cameras), objects)


def place_objects(
    rng: np.random.Generator, classes: tuple[int, ...], centre: tuple[float, float] = (0.0, 0.0)
) -> tuple[ToyObject, ...]:
    """Objects in random attitudes on a table of 0.2 m radius, centres at least 5 cm apart."""
    spots: list[FloatArray] = []
    while len(spots) < len(classes):
        spot = rng.uniform(-0.2, 0.2, size=2)
        if np.linalg.norm(spot) < 0.2 and all(np.linalg.norm(spot - other) > 0.05 for other in spots):
            spots.append(spot)
    return tuple(
        ToyObject(obj_id, se3.from_parts(so3.random(rng), np.array([*(spot + centre), 0.05])))
        for obj_id, spot in zip(classes, spots, strict=True)
    )


def looking_at(eye: FloatArray, target: FloatArray) -> FloatArray:
    """world_from_camera of a camera at `eye` looking at `target`; world z points up, image y down."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    return se3.from_parts(np.stack((right, np.cross(forward, right), forward), axis=-1), eye)


def misplaced(world_from_object: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A pose with any attitude, 10 to 20 cm away: a gross error that no symmetry explains."""
    shift = rng.normal(size=3)
    shift *= rng.uniform(0.1, 0.2) / np.linalg.norm(shift)
    return se3.from_parts(so3.random(rng), world_from_object[:3, 3] + shift)


def detect(
    camera: Camera, camera_from_object: FloatArray, catalogue: Catalogue, obj_id: int, score: float, noise: float,
    rng: np.random.Generator,
) -> Detection:  # fmt: skip
    """What a network would report of an object at a pose: keypoints with `noise` pixels per axis, true box."""
    model = catalogue[obj_id]
    assert model.keypoints is not None
    keypoints = camera.project(se3.act(camera_from_object, model.keypoints))
    corners = camera.project(se3.act(camera_from_object, model.box_corners()))
    return Detection(
        obj_id,
        score,
        box=np.concatenate((corners.min(0), corners.max(0))),
        keypoints=keypoints + noise * rng.normal(size=keypoints.shape),
        visibility=np.ones(len(keypoints)),
        std=np.full(keypoints.shape, max(noise, PIXEL_FLOOR)),
    )


def camera_error(true_poses: Mapping[str, FloatArray], component: Component) -> tuple[float, float]:
    """Greatest error (rad, m) of any relative camera pose of a component, given world_from_camera by view id."""
    errors = [(0.0, 0.0)]
    for a in component.cameras:
        for b in component.cameras:
            found = se3.inverse(a.world_from_camera) @ b.world_from_camera
            truth = se3.inverse(true_poses[a.view_id]) @ true_poses[b.view_id]
            twist = se3.minus(found, truth)
            distance = np.linalg.norm(found[:3, 3] - truth[:3, 3])
            errors.append((float(np.linalg.norm(twist[:3])), float(distance)))
    return max(e[0] for e in errors), max(e[1] for e in errors)


def distance_to_nearest(pose: FloatArray, truths: FloatArray, model: ObjectModel) -> float:
    """Symmetric distance (m) of a pose to the nearest of the true ones (n, 4, 4); continuous angles are exact."""
    twins = pose @ model.symmetries.closest(truths, pose, model.diameter / 2)
    return float(symmetric_distance(twins, truths, model.symmetries.transforms(), model.box_corners()).min())


def object_errors(world: ToyWorld, component: Component) -> list[float]:
    """For each placed object its symmetric distance (m) to the closest true object of its class."""
    gauge = component.cameras[0]
    true_from_world = world.world_from_camera[gauge.view_id] @ se3.inverse(gauge.world_from_camera)
    errors: list[float] = []
    for placed in component.objects:
        model = world.catalogue[placed.obj_id]
        truths = np.stack([o.world_from_object for o in world.objects if o.obj_id == placed.obj_id])
        errors.append(distance_to_nearest(true_from_world @ placed.world_from_object, truths, model))
    return errors
