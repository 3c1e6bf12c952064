"""Flat-shaded polyhedra before noise, written as a BOP data set: enough to learn from within seconds."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from multicam.dataset.bop_writer import InstanceLabels, LabelledImage, SceneWriter, write_models
from multicam.dataset.objects import Catalogue, ObjectModel
from multicam.geometry import se3, so3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.symmetry import Symmetries

KEYPOINTS = 8
WIDTH, HEIGHT = 160, 128


def box_mesh(x: float, y: float, z: float, colours: list[tuple[int, int, int]]) -> Mesh:
    """A box with sides x, y, z (metres); each of its six sides in one colour, so faces own their vertices."""
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) - 0.5
    corners = corners * (x, y, z)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    vertices = np.concatenate([corners[list(quad)] for quad in quads])
    faces = np.concatenate([[[4 * i, 4 * i + 1, 4 * i + 2], [4 * i, 4 * i + 2, 4 * i + 3]] for i in range(6)])
    return Mesh(vertices, faces, np.repeat(np.array(colours, dtype=np.uint8), 4, axis=0))


def toy_objects() -> tuple[Catalogue, dict[int, Mesh]]:
    """An asymmetric coloured brick (class 2) and a plate that half turns about z leave unchanged (class 5)."""
    brick = box_mesh(
        0.12, 0.08, 0.05,
        [(220, 40, 40), (40, 200, 60), (50, 80, 230), (230, 210, 40), (200, 60, 200), (60, 210, 210)],
    )  # fmt: skip
    plate = box_mesh(
        0.14, 0.06, 0.02,
        [(240, 140, 30), (240, 140, 30), (120, 70, 20), (120, 70, 20), (250, 250, 250), (40, 40, 40)],
    )  # fmt: skip
    turn = se3.from_parts(so3.exp(np.array([0, 0, np.pi])), np.zeros(3))
    meshes = {2: brick, 5: plate}
    symmetries = {2: Symmetries(), 5: Symmetries(turn[None])}
    objects = {
        i: ObjectModel(
            i, f"toy_{i}", mesh.diameter(), symmetries[i], mesh.box, np.unique(mesh.vertices.round(9), axis=0)
        )
        for i, mesh in meshes.items()
    }
    return Catalogue(objects), meshes


def toy_picture(rng: np.random.Generator) -> LabelledImage:
    """Both objects side by side at random rotations, about 0.5 m away."""
    catalogue, meshes = toy_objects()
    camera = Camera.from_focal(180.0, WIDTH, HEIGHT)
    image = rng.integers(90, 130, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    rows: list[InstanceLabels] = []
    for side, (obj_id, mesh) in zip((-1, 1), meshes.items(), strict=True):
        place = np.array([side * rng.uniform(0.08, 0.12), rng.uniform(-0.06, 0.06), rng.uniform(0.45, 0.6)])
        pose = se3.from_parts(so3.random(rng), place)
        mask = _draw(image, mesh, pose, camera)
        keypoints = catalogue[obj_id].keypoints
        assert keypoints is not None
        pixels = camera.project(se3.act(pose, keypoints))
        outline = camera.project(se3.act(pose, mesh.vertices))
        box = np.concatenate((outline.min(0), outline.max(0)))
        visible = np.ones(KEYPOINTS, dtype=np.bool_)
        rows.append(InstanceLabels(obj_id, pose, box, mask, mask, 1.0, int(mask.sum()), pixels, visible))
    depth = np.zeros((HEIGHT, WIDTH), dtype=np.float32)
    return LabelledImage(camera, np.eye(4), image, depth, tuple(rows))


def write_toy_dataset(folder: Path, count: int, seed: int = 0) -> None:
    """Writes folder/models and folder/train with one scene of `count` pictures."""
    catalogue, meshes = toy_objects()
    write_models(folder / "models", catalogue, meshes)
    writer, rng = SceneWriter(folder / "train" / "000001"), np.random.default_rng(seed)
    for im_id in range(count):
        writer.add(im_id, toy_picture(rng))


def _draw(image: np.ndarray, mesh: Mesh, pose: np.ndarray, camera: Camera) -> np.ndarray:
    """Paints the faces from far to near; returns the silhouette."""
    points = se3.act(pose, mesh.vertices)
    pixels = camera.project(points)
    mask = np.zeros(image.shape[:2], dtype=np.uint8)
    light = np.array([0.3, -0.5, -0.8])
    assert mesh.colors is not None
    for face in sorted(mesh.faces, key=lambda f: -points[f, 2].mean()):
        normal = np.cross(points[face[1]] - points[face[0]], points[face[2]] - points[face[0]])
        shade = 0.6 + 0.4 * abs(normal @ light) / np.linalg.norm(normal)
        polygon = np.rint(pixels[face] * 16).astype(np.int32)
        cv2.fillConvexPoly(image, polygon, (mesh.colors[face[0]] * shade).tolist(), cv2.LINE_AA, 4)
        cv2.fillConvexPoly(mask, polygon, 1, cv2.LINE_8, 4)
    return mask > 0
