"""Cameras of rendered recordings before and after their adjustment: joint, in turns, and with the published step.

    python benchmarks/bundle_rigs.py RECORDING [RECORDING ...] [--every 4] [--keypoints 2.5]

Each group is one moment of a recording; it is worse if the mean error of its cameras is. Estimates are true poses with
the noise of estimates that state none (an outline 2.5 pixels off, depth four times worse); their joint minimum, which
is what a registration gives, is the start. With --keypoints, estimates are those of PnP on keypoints that are off by so
many pixels, one in twenty by up to 30, and two more rows tell what keypoints add to the covariances of those poses.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from registration import machine
from rich.console import Console
from rich.table import Table

from multicam.bundle.adjustment.adjust import Adjusted, adjust
from multicam.bundle.adjustment.config import AdjustmentConfig
from multicam.bundle.adjustment.descent import UNKNOWN, Participants, System
from multicam.bundle.adjustment.keypoints import EdgeKeypoints
from multicam.bundle.adjustment.scene import Body, Picture, Scene
from multicam.bundle.adjustment.search import Found, edge_poses, find_occluders, learn_colors
from multicam.bundle.depth_image import DepthImage
from multicam.bundle.levenberg import LevenbergConfig, minimize
from multicam.bundle.problem import Problem, State
from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.viewpoints.cache import load_viewpoints
from multicam.bundle.viewpoints.generate import ViewpointConfig
from multicam.dataset.objects import ObjectModel
from multicam.dataset.sequence import Recording, load_recording
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import load_mesh
from multicam.inference.pnp import PnpConfig, PnpRefusal, solve_pnp
from multicam.matching.linear import apply, inverse, squared_norm
from multicam.matching.noise import NoiseConfig, geometric_covariance
from multicam.progress import RichProgress
from multicam.types import FloatArray, FrameSet

VISIBLE = 0.3
"""Least visible share of an object that is taken for detected."""

SAME = 0.02
"""Metres between two objects of one class that are one."""

GROSS = 0.05
"""Share of keypoints that are grossly wrong, with --keypoints."""

RGB = AdjustmentConfig(depth=None, measured_occlusion=False)
RGBD = AdjustmentConfig()
VARIANTS = {
    "RGB, joint": RGB,
    "RGB, joint, scenery": replace(RGB, scenery=SceneryConfig()),
    "RGB, in turns (paper)": replace(RGB, joint=False),
    "RGB-D, joint": RGBD,
    "RGB-D, joint, scenery": replace(RGBD, scenery=SceneryConfig()),
    "RGB-D, in turns (paper)": replace(RGBD, joint=False),
    "RGB-D, no region": replace(RGBD, region=None),
    "RGB-D, no occlusion": replace(RGBD, modelled_occlusion=False, measured_occlusion=False),
}
PUBLISHED = {"RGB, published step": RGB, "RGB-D, published step": RGBD}


class PublishedStep(System):
    """The step of the authors' code: cameras and objects from one linearisation, without each other; the Jacobian of a
    perturbation on the right is applied on the left, and the camera's step is shortened to 15 percent."""

    def step(self, found: Found, state: State, weight: FloatArray) -> tuple[State, FloatArray]:
        pose = edge_poses(self.scene, state)
        local, free = found.linearize(pose), ~self.participants.fixed
        bare = replace(self, scene=without_estimates(self.scene))
        cameras = bare.assemble(local, pose, state, np.ones_like(weight), damped=False)
        main = np.where(self.scene.camera == 0, 1.0, 0.1)
        objects = bare.assemble(local, pose, state, main)
        step = -0.15 * apply(inverse(cameras.camera_hessian[free]), cameras.camera_gradient[free])
        world_from_camera = state.world_from_camera.copy()
        world_from_camera[free] = se3.exp(step) @ world_from_camera[free]
        moved = -apply(inverse(objects.object_hessian), objects.object_gradient)
        return State(world_from_camera, se3.plus(state.world_from_object, moved)), weight


@dataclass(frozen=True, eq=False)
class Case:
    """One moment: scene, start and true cameras."""

    scene: Scene
    start: State
    truth: FloatArray


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path, nargs="+")
    parser.add_argument("--every", type=int, default=4, help="use every n-th moment")
    parser.add_argument("--keypoints", type=float, metavar="PX", help="standard deviation of keypoints")
    options = parser.parse_args()
    print(machine())
    rng = np.random.default_rng(0)
    detector = Detector(options.keypoints, rng)
    cases = [
        case for folder in options.recordings for case in cases_of(load_recording(folder), options.every, detector)
    ]
    before = np.concatenate([error(case, case.start) for case in cases])
    columns = ("method", "cameras", "mean mm", "median", "p90", "mean deg", "halved %", "worse %", "groups worse %")
    table = Table(*columns, "kept", "NEES")
    rows = {"start": [(case, case.start, None) for case in cases]}
    for name, config in VARIANTS.items():
        answers = [(case, adjust(case.scene, case.start, config)) for case in cases]
        rows[name] = [(case, answer.state, answer) for case, answer in answers]
    answers = [(case, adjust(without_estimates(case.scene), case.start, RGBD)) for case in cases]
    rows["RGB-D, no estimates"] = [(case, answer.state, answer) for case, answer in answers]
    if options.keypoints:
        for name in ("RGB, joint", "RGB-D, joint"):
            poses = [(case, replace(case.scene, keypoints=EdgeKeypoints.none())) for case in cases]
            answers = [(case, adjust(scene, case.start, VARIANTS[name])) for case, scene in poses]
            rows[f"{name}, poses for keypoints"] = [(case, answer.state, answer) for case, answer in answers]
    for name, config in PUBLISHED.items():
        rows[name] = [(case, published(case, config), None) for case in cases]
    for name, row in rows.items():
        after = np.concatenate([error(case, state) for case, state, _ in row])
        turned = np.concatenate([error(case, state, rotation=True) for case, state, _ in row])
        figures = (after.mean(), np.median(after), np.percentile(after, 90), turned.mean())
        moments = np.array([error(case, state).mean() > error(case, case.start).mean() for case, state, _ in row])
        shares = (np.mean(after <= before / 2), np.mean(after > before), np.mean(moments))
        kept = sum(len(answer.kept_cameras) for _, _, answer in row if answer is not None)
        honest = [nees(case, answer) for case, _, answer in row if answer is not None]
        table.add_row(
            name, str(len(after)), *(f"{x:.1f}" for x in figures[:3]), f"{figures[3]:.2f}",
            *(f"{100 * x:.1f}" for x in shares), str(kept),
            f"{np.median(np.concatenate(honest)):.1f}" if honest else "",
        )  # fmt: skip
    Console(width=140).print(table)


def without_estimates(scene: Scene) -> Scene:
    """The scene in which estimates, and so keypoints, say where to begin and next to nothing more."""
    hardly = np.tile(UNKNOWN * np.eye(6), (len(scene.camera), 1, 1))
    return replace(scene, information=hardly, keypoints=EdgeKeypoints.none())


def error(case: Case, state: State, rotation: bool = False) -> FloatArray:
    """Of each free camera, millimetres or degrees."""
    shift = se3.minus(state.world_from_camera, case.truth)[~case.scene.fixed]
    if rotation:
        return np.degrees(np.linalg.norm(shift[:, :3], axis=1))
    return 1e3 * np.linalg.norm((state.world_from_camera - case.truth)[~case.scene.fixed, :3, 3], axis=1)


def nees(case: Case, answer: Adjusted) -> FloatArray:
    """Squared Mahalanobis distances of the free cameras from the truth; their median should be 5.3."""
    free = ~case.scene.fixed
    shift = se3.minus(case.truth, answer.state.world_from_camera)[free]
    return squared_norm(shift, inverse(answer.camera_covariance[free]))


def published(case: Case, config: AdjustmentConfig) -> State:
    """The state after the published steps, accepted as it comes."""
    occluders = find_occluders(case.scene, case.start, config)
    colors = learn_colors(case.scene, case.scene.estimated, occluders, config)
    everything = np.ones(len(case.scene.bodies), dtype=np.bool_)
    taking = Participants(np.ones_like(case.scene.fixed), everything, case.scene.fixed)
    steps = PublishedStep(case.scene, taking, occluders, colors, config)
    return steps.descend(case.start, range(config.searches)).state


def cases_of(recording: Recording, every: int, detector: Detector) -> list[Case]:
    """Moments of a recording at which objects tie at least two cameras together."""
    folder = recording.folder / "models"
    meshes = {o: load_mesh(folder / f"obj_{o:06d}.ply", 1e-3) for o in recording.catalogue.obj_ids}
    models = load_viewpoints(meshes, ViewpointConfig(), RichProgress())
    bodies = {o: Body(models[o], meshes[o]) for o in meshes}
    entries = {(c.camera_id, e.timestamp_ns): e.im_id for c in recording.cameras for e in c.frames}
    cases = [case_of(recording, moment, entries, bodies, detector) for moment in list(recording.frame_sets())[::every]]
    return [case for case in cases if case is not None]


def case_of(
    recording: Recording,
    moment: FrameSet,
    entries: dict[tuple[str, int], int],
    bodies: dict[int, Body],
    detector: Detector,
) -> Case | None:
    """A moment with noisy estimates of what each camera sees; None if too few objects are shared."""
    truth, places, classes = [], list[FloatArray](), list[int]()
    edges: list[tuple[int, int, FloatArray]] = []
    for c, frame in enumerate(moment.frames):
        im_id = entries[frame.camera_id, frame.timestamp_ns]
        truth.append(recording.truth_of(frame.camera_id, im_id))
        for each in recording.record(frame.camera_id, im_id).instances:
            if (each.visible_fraction or 0) < VISIBLE:
                continue
            place = truth[-1] @ each.camera_from_object
            same = [
                o for o, (k, p) in enumerate(zip(classes, places, strict=True)) if k == each.obj_id and near(p, place)
            ]
            if not same:
                classes.append(each.obj_id)
                places.append(place)
            edges.append((c, same[0] if same else len(places) - 1, each.camera_from_object))
    count = np.bincount([o for _, o, _ in edges], minlength=len(places))
    edges = [edge for edge in edges if count[edge[1]] >= 2]
    if not edges:
        return None
    used = sorted({o for _, o, _ in edges})
    camera, obj = np.array([c for c, _, _ in edges]), np.array([used.index(o) for _, o, _ in edges])
    known = [recording.catalogue[classes[used[o]]] for o in obj]
    exact = np.array([pose for _, _, pose in edges])
    estimated, covariance, keypoints = detector.estimates(exact, known, [moment.frames[c].camera for c in camera])
    pictures = [
        Picture(f.image, f.camera, None if f.depth is None else DepthImage(f.depth, f.camera, np.eye(4)))
        for f in moment.frames
    ]
    world_from_camera, fixed = np.array(truth), np.arange(len(truth)) == np.bincount(camera).argmax()
    scene = Scene(
        pictures=pictures,
        bodies=[bodies[classes[o]] for o in used],
        camera=camera,
        object=obj,
        estimated=estimated,
        information=inverse(covariance),
        fixed=fixed,
        camera_covariance=np.zeros((len(truth), 6, 6)),
        object_covariance=np.zeros((len(used), 6, 6)),
        keypoints=keypoints.as_sure_as(estimated, covariance),
    )
    everything = np.ones(len(truth), dtype=np.bool_), np.ones(len(used), dtype=np.bool_)
    scene = replace(scene, fixed=fixed | scene.unrelated(*everything))
    problem = Problem(scene.priors(2.0), scene.fixed)
    start = minimize(problem, State(world_from_camera, np.array(places)[used]), LevenbergConfig()).state
    cameras, objects = problem.covariances(start)
    return Case(replace(scene, camera_covariance=cameras, object_covariance=objects), start, world_from_camera)


@dataclass(frozen=True, eq=False)
class Detector:
    """Stands in for a network.

    Attributes:
        std: of keypoints, pixels; None for estimates without keypoints.
    """

    std: float | None
    rng: np.random.Generator

    def estimates(
        self, exact: FloatArray, models: Sequence[ObjectModel], cameras: Sequence[Camera]
    ) -> tuple[FloatArray, FloatArray, EdgeKeypoints]:
        """Poses (e, 4, 4) and covariances (e, 6, 6) of edges with true poses (e, 4, 4), and keypoints behind them."""
        corners = np.array([model.box_corners() for model in models])
        focal = np.array([camera.matrix[0, 0] for camera in cameras])
        pose, covariance = estimates_of(exact, corners, focal, self.rng)
        keypoints = [EdgeKeypoints.none()]
        for edge, (model, camera) in enumerate(zip(models, cameras, strict=True)):
            if self.std is None or model.keypoints is None or model.symmetries.axes:
                continue
            pixel = camera.project(se3.act(exact[edge], model.keypoints))
            pixel += self.std * self.rng.normal(size=pixel.shape)
            pixel += (self.rng.uniform(size=(len(pixel), 1)) < GROSS) * self.rng.uniform(-30, 30, size=pixel.shape)
            std = np.full(pixel.shape, self.std)
            found = solve_pnp(pixel, std, np.ones(len(pixel)), model.keypoints, camera, PnpConfig())
            # What PnP refuses stays an estimate without keypoints.
            if not isinstance(found, PnpRefusal):
                pose[edge], covariance[edge] = found.camera_from_object, found.covariance
                of_edge = np.full(len(pixel), edge), model.keypoints, pixel, std
                keypoints.append(EdgeKeypoints(*of_edge, np.tile(camera.matrix, (len(pixel), 1, 1))))
        return pose, covariance, EdgeKeypoints.joined(keypoints)


def estimates_of(
    exact: FloatArray, corners: FloatArray, focal: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """True poses (n, 4, 4) with the noise of estimates that state none, and its covariances (n, 6, 6)."""
    covariance = geometric_covariance(exact, corners, focal, NoiseConfig())
    noise = np.einsum("eij,ej->ei", np.linalg.cholesky(covariance), rng.normal(size=(len(exact), 6)))
    return se3.plus(exact, noise), covariance


def near(a: FloatArray, b: FloatArray) -> bool:
    return bool(np.linalg.norm(a[:3, 3] - b[:3, 3]) < SAME)


if __name__ == "__main__":
    main()
