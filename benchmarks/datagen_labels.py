"""Labels of a rendered data set against a ray caster (Embree) that shares no code with the renderer or the labels.

    python benchmarks/datagen_labels.py --data data/instruments --count 300

From meshes, poses and camera matrices alone: whole silhouettes against mask/, depth of what is visible against depth/,
projected keypoints against scene_keypoints.json, and the visible share against scene_gt_info.json. Needs the extra dev.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from rich.console import Console
from rich.progress import track
from rich.table import Table
from trimesh.ray.ray_pyembree import RayMeshIntersector

from multicam.config import parse_command
from multicam.types import FloatArray

LIMITS = {"mask IoU": 0.99, "depth, mm": 0.5, "keypoints, px": 0.5, "visible fraction": 0.02}
"""A mask's overlap must reach its limit; the errors must stay below theirs."""
IN_FRONT = 1.0
"""Millimetres before the camera from which on a point has an image."""


@dataclass(frozen=True)
class LabelsConfig:
    """Options of the benchmark."""

    data: Path
    """Data set folder, or one split of it."""
    count: int = 300
    """Pictures, drawn at random."""
    seed: int = 0
    """Of the draw."""


@dataclass(frozen=True)
class Finding:
    """One labelled object: where it is, its pixels, and the figure of each kind that applies."""

    name: str
    pixels: int
    figures: dict[str, float]


def main() -> None:
    config = parse_command(LabelsConfig, sys.argv[1:], "datagen_labels.py", __doc__ or "")
    pictures = [
        (path.parent, key)
        for path in sorted((*config.data.glob("*/scene_gt.json"), *config.data.glob("*/*/scene_gt.json")))
        for key in json.loads(path.read_text())
    ]
    drawn = np.random.default_rng(config.seed).permutation(len(pictures))[: config.count]
    findings = [finding for i in track(drawn, "casting rays") for finding in check(*pictures[i])]
    Console().print(report(findings, len(drawn)))
    for kind in LIMITS:
        worst = sorted((f for f in findings if kind in f.figures), key=lambda f: _badness(kind, f.figures[kind]))[-4:]
        print(f"worst {kind}: " + "; ".join(f"{f.figures[kind]:.4f} {f.name} ({f.pixels} px)" for f in reversed(worst)))


def report(findings: list[Finding], pictures: int) -> Table:
    table = Table("", "median", "1 in 100 is worse than", "worst", "limit", "beyond it", "of")
    table.title = f"{len(findings)} labelled objects in {pictures} pictures"
    for kind, limit in LIMITS.items():
        values = np.array([f.figures[kind] for f in findings if kind in f.figures])
        order = values[np.argsort([_badness(kind, value) for value in values])]
        beyond = sum(_badness(kind, value) > _badness(kind, limit) for value in values)
        numbers = (np.median(order), order[int(0.99 * (len(order) - 1))], order[-1])
        table.add_row(kind, *(f"{n:.4f}" for n in numbers), str(limit), str(beyond), str(len(values)))
    return table


def _badness(kind: str, value: float) -> float:
    return 1 - value if kind == "mask IoU" else value


def check(scene: Path, key: str) -> Iterator[Finding]:
    """Every labelled object of a picture."""
    camera = _table(scene, "scene_camera")[key]
    matrix = np.reshape(camera["cam_K"], (3, 3))
    depth = cv2.imread(str(scene / "depth" / f"{int(key):06d}.png"), cv2.IMREAD_UNCHANGED) * camera["depth_scale"]
    for index, pose in enumerate(_table(scene, "scene_gt")[key]):
        stem = f"{int(key):06d}_{index:06d}.png"
        whole, visible = (
            cv2.imread(str(scene / kind / stem), cv2.IMREAD_UNCHANGED) > 0 for kind in ("mask", "mask_visib")
        )
        rotation, translation = np.reshape(pose["cam_R_m2c"], (3, 3)), np.array(pose["cam_t_m2c"])
        model = _model(scene, pose["obj_id"])
        cast, start = _cast(model, matrix, rotation, translation, whole.shape)
        inside = _inside(cast, start, whole.shape)
        silhouette = inside > 0
        figures = {"mask IoU": float((silhouette & whole).sum() / max((silhouette | whole).sum(), 1))}
        both = visible & silhouette & (depth > 0)
        if both.any():
            figures["depth, mm"] = float(np.median(np.abs(inside - depth)[both]))
        stated = _table(scene, "scene_gt_info")[key][index]["visib_fract"]
        figures["visible fraction"] = abs(min(1.0, visible.sum() / max((cast > 0).sum(), 1)) - stated)
        points = _keypoints(scene)[str(pose["obj_id"])] @ rotation.T + translation
        front = points[:, 2] > IN_FRONT
        if front.any():
            pixels = (points / points[:, 2:]) @ matrix.T
            labelled = np.array(_table(scene, "scene_keypoints")[key][index])
            figures["keypoints, px"] = float(np.abs(pixels[:, :2] - labelled[:, :2])[front].max())
        yield Finding(f"{scene.parent.name}/{scene.name}/mask/{stem}", int(whole.sum()), figures)


def _cast(
    model: tuple[trimesh.Trimesh, RayMeshIntersector],
    matrix: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    shape: tuple[int, ...],
) -> tuple[FloatArray, tuple[int, int]]:
    """Depth (mm, 0 beside the object) on a canvas that reaches one image beyond each border, and its (row, column).

    The canvas is cut to where the object can be.
    """
    mesh, intersector = model
    height, width = shape
    low, high = np.array([-width, -height]), np.array([2 * width, 2 * height])
    points = mesh.vertices @ rotation.T + translation
    if (points[:, 2] > IN_FRONT).all():
        pixels = ((points / points[:, 2:]) @ matrix.T)[:, :2]
        # An object beside the canvas still has one pixel cast, which misses it.
        low = np.clip(np.floor(pixels.min(0)).astype(int) - 1, low, high - 1)
        high = np.clip(np.ceil(pixels.max(0)).astype(int) + 2, low + 1, high)
    columns, rows = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    rays = np.stack((columns, rows, np.ones_like(rows)), axis=-1).reshape(-1, 3) @ np.linalg.inv(matrix).T
    directions = rays @ rotation
    origin = -translation @ rotation
    hit = intersector.intersects_first(np.broadcast_to(origin, directions.shape), directions)
    # Embree says which face, in float32; where on it is computed here. Rays have depth 1 along the optical axis.
    corners = mesh.triangles[hit]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.einsum("ni,ni->n", normals, corners[:, 0] - origin) / np.einsum("ni,ni->n", normals, directions)
    return np.where(hit >= 0, depth, 0).reshape(rows.shape), (int(low[1]), int(low[0]))


def _inside(canvas: FloatArray, start: tuple[int, int], shape: tuple[int, ...]) -> FloatArray:
    """The part of the canvas that is the image."""
    image = np.zeros(shape)
    top, left = max(start[0], 0), max(start[1], 0)
    bottom, right = min(start[0] + canvas.shape[0], shape[0]), min(start[1] + canvas.shape[1], shape[1])
    if top < bottom and left < right:
        image[top:bottom, left:right] = canvas[top - start[0] : bottom - start[0], left - start[1] : right - start[1]]
    return image


@lru_cache(maxsize=64)
def _table(scene: Path, name: str) -> dict[str, Any]:
    return json.loads((scene / f"{name}.json").read_text())


@lru_cache
def _keypoints(scene: Path) -> dict[str, FloatArray]:
    table = json.loads((scene.parents[1] / "models" / "keypoints.json").read_text())
    return {obj_id: np.array(points) for obj_id, points in table.items()}


@lru_cache(maxsize=256)
def _model(scene: Path, obj_id: int) -> tuple[trimesh.Trimesh, RayMeshIntersector]:
    return _load_model(scene.parents[1] / "models" / f"obj_{obj_id:06d}.ply")


@lru_cache(maxsize=64)
def _load_model(path: Path) -> tuple[trimesh.Trimesh, RayMeshIntersector]:
    mesh = trimesh.load_mesh(path, process=False)
    return mesh, RayMeshIntersector(mesh)


if __name__ == "__main__":
    main()
