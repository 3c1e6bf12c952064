"""Our factors against numbers and pictures that M3T, the reference implementation, has stored with its own tests.

M3T computed them from models of 200 points in 2562 views, which are not among its files; `m3t_views` draws the one view
that counts as M3T drew it, which is first proved on models that are there. The pose is the body's start pose, the
pictures are frame 200, histograms are those of that very pose, and all parameters are those of the first search.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from multicam.bundle.depth.factor import DepthFactor
from multicam.bundle.depth.points import find_points
from multicam.bundle.depth_image import DepthImage, draw_bodies
from multicam.bundle.factor import Linearization
from multicam.bundle.occlusion import Occluders
from multicam.bundle.region.factor import RegionFactor
from multicam.bundle.region.lines import find_lines
from multicam.bundle.tracking import Sight, TrackingConfig, first_colors, track
from multicam.bundle.viewpoints.model import ViewpointModel
from multicam.geometry import se3, so3
from multicam.geometry.mesh import Mesh
from tests.bundle.box_world import viewpoint_model
from tests.bundle.m3t_files import read_camera, read_matrix, read_model, read_yaml
from tests.bundle.m3t_views import M3tView, contour_points, geodesic_directions, surface_points

CONFIG = TrackingConfig(searches=1, updates=1)
ONE = np.zeros(1, dtype=np.int64)

# World from body, as M3T's tests set them (its tests/common_test.cpp, there inverted).
ROTATION = np.array(
    [[0.607676, 0.786584, -0.109620], [0.408914, -0.428213, -0.805867], [-0.680823, 0.444880, -0.58186]]
)
TRIANGLE = np.array([0.472944, -0.213009, 0.346384])
BOTTLE = np.array([0.297794, -0.189009, 0.255284])


def placed(body_from_world: np.ndarray) -> np.ndarray:
    rotation = so3.project(ROTATION)
    return se3.from_parts(rotation, -rotation @ body_from_world)


@dataclass(frozen=True)
class Oracle:
    """The folder of M3T's test data."""

    folder: Path

    def mesh(self, name: str) -> Mesh:
        loaded = trimesh.load(self.folder / f"_body/{name}.obj", process=False, maintain_order=True)
        shift = read_yaml(self.folder / f"_body/{name}.yaml")["geometry2body_pose"][:3, 3]
        return Mesh(np.asarray(loaded.vertices, dtype=np.float64) + shift, np.asarray(loaded.faces, dtype=np.int64))

    @cached_property
    def sight(self) -> Sight:
        camera, world_from_camera = read_camera(self.folder / "_sequence/color_camera.yaml")
        depth_camera, world_from_depth = read_camera(self.folder / "_sequence/depth_camera.yaml")
        image = cv2.cvtColor(self.picture("_sequence/color_camera_image_200"), cv2.COLOR_BGR2RGB)
        depth = self.picture("_sequence/depth_camera_image_200").astype(np.float32) / np.float32(1000)
        camera_from_world = se3.inverse(world_from_camera)
        depth_from_camera = se3.inverse(camera_from_world @ world_from_depth)
        return Sight(image, camera, camera_from_world, DepthImage(depth, depth_camera, depth_from_camera))

    @cached_property
    def model(self) -> ViewpointModel:
        mesh, directions = self.mesh("triangle"), geodesic_directions(4)
        pose = placed(TRIANGLE)
        direction = directions[np.argmax(directions @ (pose[:3, :3].T @ pose[:3, 3]))]
        view = M3tView(mesh, direction)
        return viewpoint_model(direction, *contour_points(view, 200), *surface_points(view, mesh, 200))

    def picture(self, name: str) -> np.ndarray:
        return cv2.imread(str(self.folder / f"{name}.png"), cv2.IMREAD_UNCHANGED)

    def stored(self, name: str) -> np.ndarray:
        return read_matrix(self.folder / f"modality_test/{name}.txt")

    def lines(self, sight: Sight) -> np.ndarray:
        assert CONFIG.region is not None
        colors = first_colors(self.model, sight, placed(TRIANGLE), CONFIG.region)
        pose = sight.camera_from_world @ placed(TRIANGLE)
        return find_lines(self.model, sight.image, sight.camera.matrix, pose, colors, sight.occluders, 0, CONFIG.region)

    def region(self, local: bool) -> Linearization:
        assert CONFIG.region is not None
        lines, matrix = self.lines(self.sight), self.sight.camera.matrix
        factor = RegionFactor.of_edges(ONE, ONE, matrix[None], [lines], CONFIG.region)
        return factor.in_update(int(local), CONFIG.region).linearize(
            (self.sight.camera_from_world @ placed(TRIANGLE))[None]
        )

    def pairs(self, occluders: Occluders) -> np.ndarray:
        assert CONFIG.depth is not None and self.sight.depth is not None
        pose = self.sight.camera_from_world @ placed(TRIANGLE)
        return find_points(self.model, self.sight.depth, pose, occluders, 0, CONFIG.depth)


@pytest.fixture(scope="module")
def oracle(bench_dir: Path) -> Oracle:
    return Oracle(bench_dir / "m3t_oracle")


def apart(ours: np.ndarray, theirs: np.ndarray) -> float:
    return float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs))


@pytest.mark.parametrize("index", [0, 24, 48, 90, 120, 150])
def test_views_are_drawn_as_m3t_draws_them(oracle: Oracle, index: int) -> None:
    bottle = oracle.mesh("schauma")
    region, depth = (read_model(oracle.folder / f"model_test/{kind}_model.bin") for kind in ("region", "depth"))
    parameters = region.parameters
    view = M3tView(bottle, region.direction[index], parameters["sphere_radius"], int(parameters["image_size"]))
    contour, length = contour_points(view, int(parameters["n_points"]))
    assert length == pytest.approx(region.measure[index], rel=1e-5)
    for name in ("point", "normal", "offset"):
        assert contour[name] == pytest.approx(region.points[name][index], abs=3e-5)
    surface, area = surface_points(view, bottle, int(parameters["n_points"]))
    # A pixel or two on the border fall otherwise on the graphics card.
    assert area == pytest.approx(depth.measure[index], rel=2e-4)
    assert surface["point"] == pytest.approx(depth.points["point"][index], abs=3e-5)
    # Normals hold 8 bits; a point on an edge may belong to the neighbour.
    assert np.median(np.abs(surface["normal"] - depth.points["normal"][index])) < 1e-5


def test_directions_are_those_of_m3t(oracle: Oracle) -> None:
    stored = read_model(oracle.folder / "model_test/region_model.bin").direction
    ours = geodesic_directions(2)
    assert len(ours) == len(stored)
    assert np.max(ours @ stored.T, axis=0) == pytest.approx(np.ones(len(stored)), abs=1e-6)


@pytest.mark.parametrize("local", [False, True])
def test_region_gradients_and_hessians_agree(oracle: Oracle, local: bool) -> None:
    ours, name = oracle.region(local), "local" if local else "global"
    # M3T has those of the log-likelihood. Its pose has six digits and 32 bits: a thousandth of a pixel, which
    # shows in the global gradient, whose terms largely cancel.
    gradient = -oracle.stored(f"region_modality_{name}_gradient")[:, 0]
    assert apart(ours.gradient[0], gradient) < 1e-3
    assert apart(ours.hessian[0], -oracle.stored(f"region_modality_{name}_hessian")) < 1e-5


def test_depth_gradients_and_hessians_agree(oracle: Oracle) -> None:
    pairs = oracle.pairs(Occluders())
    pose = oracle.sight.camera_from_world @ placed(TRIANGLE)
    ours = DepthFactor.of_edges(ONE, ONE, [pairs]).linearize(pose[None])
    assert apart(ours.gradient[0], -oracle.stored("depth_modality_gradient")[:, 0]) < 1e-4
    assert apart(ours.hessian[0], -oracle.stored("depth_modality_hessian")) < 1e-5


def test_one_step_ends_at_the_pose_of_m3t(oracle: Oracle) -> None:
    damping = read_yaml(oracle.folder / "optimizer_test/optimizer.yaml")
    config = replace(
        CONFIG,
        rotation_damping=damping["tikhonov_parameter_rotation"],
        translation_damping=damping["tikhonov_parameter_translation"],
    )
    assert config.region is not None
    start = placed(TRIANGLE)
    colors = first_colors(oracle.model, oracle.sight, start, config.region)
    found = track(oracle.model, [oracle.sight], [colors], start, config).world_from_object
    stored = read_matrix(oracle.folder / "optimizer_test/triangle_pose.txt")
    assert np.linalg.norm(found[:3, 3] - stored[:3, 3]) < 1e-5
    assert np.linalg.norm(found[:3, :3] - stored[:3, :3]) < 1e-5
    # It was worth a test: the step is 1.6 mm.
    assert np.linalg.norm(start[:3, 3] - stored[:3, 3]) > 1e-3


def line_pixels(oracle: Oracle, lines: np.ndarray) -> np.ndarray:
    """Mask of the pixels that M3T draws for lines: those under the twelve shifts."""
    camera = oracle.sight.camera
    drawn = np.zeros((camera.height, camera.width), dtype=bool)
    pixels = camera.project(se3.act(oracle.sight.camera_from_world @ placed(TRIANGLE), lines["point"]))
    steps = lines["direction"] / np.abs(lines["direction"]).max(axis=1, keepdims=True)
    along = np.arange(72) - 35.5
    x, y = np.floor(pixels[:, None] + steps[:, None] * along[:, None] + 0.5).astype(int).reshape(-1, 2).T
    drawn[y, x] = True
    return drawn


@pytest.mark.parametrize("occluded_by", ["", "_measured_occlusions", "_modeled_occlusions"])
def test_lines_are_those_that_m3t_draws(oracle: Oracle, occluded_by: str) -> None:
    sight, pose = oracle.sight, oracle.sight.camera_from_world
    assert sight.depth is not None
    bodies = [
        (oracle.mesh("triangle"), pose @ placed(TRIANGLE)),
        (oracle.mesh("schauma"), pose @ placed(BOTTLE)),
    ]
    hide = {
        "": Occluders(),
        "_measured_occlusions": Occluders((sight.depth,)),
        "_modeled_occlusions": Occluders((draw_bodies(bodies, sight.camera),)),
    }[occluded_by]
    ours = line_pixels(oracle, oracle.lines(replace(sight, occluders=hide)))
    stored = oracle.picture(f"modality_test/region_modality{occluded_by}").astype(int)
    # Lines are yellow or red on shades of gray.
    theirs = np.abs(stored - stored[..., :1]).max(axis=-1) > 1
    # M3T renders bodies coarsely, for which one line of 110 is another; without bodies rounding may move a pixel.
    different = np.count_nonzero(ours != theirs)
    assert different <= (100 if occluded_by == "_modeled_occlusions" else 3)
    assert theirs.sum() > 3000


@pytest.mark.parametrize("measured", [False, True])
def test_points_of_the_surface_are_those_that_m3t_draws(oracle: Oracle, measured: bool) -> None:
    depth = oracle.sight.depth
    assert depth is not None
    pairs = oracle.pairs(Occluders((depth,) if measured else ()))
    pose = depth.depth_from_camera @ oracle.sight.camera_from_world @ placed(TRIANGLE)
    x, y = np.floor(depth.camera.project(se3.act(pose, pairs["point"])) + 0.5).astype(int).T
    ours = np.zeros(depth.depth.shape, dtype=np.uint8)
    ours[y, x] = 1
    name = "depth_modality_measured_occlusions" if measured else "depth_modality"
    stored = oracle.picture(f"modality_test/{name}")
    theirs = np.all(stored == [187, 117, 0], axis=-1)
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=np.uint8)
    assert np.array_equal(cv2.dilate(ours, cross) > 0, theirs)
