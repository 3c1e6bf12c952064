"""Estimates brought to measured depth: boxes before a wall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from multicam.bundle.adjustment.scene import Body
from multicam.bundle.viewpoints.generate import ViewpointConfig, generate
from multicam.dataset.objects import Catalogue, ObjectModel
from multicam.errors import ConfigError
from multicam.fitter import FitConfig, Fitter
from multicam.geometry import se3
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import render_depth
from multicam.geometry.symmetry import Symmetries
from multicam.types import Detection, Frame, ObjectEstimate
from tests.bundle.box_rig import CAMERA, COLORS, WALL, body, cameras, objects, picture
from tests.bundle.box_world import box
from tests.test_adjuster import catalogue

KEYPOINTS = Detection(1, 0.9, np.zeros(4), np.zeros((8, 2)), np.ones((8, 2)), np.ones(8))


def fitter(**options: object) -> Fitter:
    return Fitter(dict.fromkeys((1, 2, 3), body()), catalogue(), FitConfig(**options))


def seen(rng: np.random.Generator, depth: bool = True) -> Frame:
    taken = picture(rng, se3.inverse(cameras()[0]), objects())
    measured = taken.depth.depth if depth and taken.depth is not None else None
    return Frame("left", 0, taken.image, CAMERA, None, measured)


def truth() -> np.ndarray:
    return se3.inverse(cameras()[0]) @ objects()


def estimates(poses: np.ndarray) -> tuple[ObjectEstimate, ...]:
    return tuple(ObjectEstimate(k + 1, 0.9, pose, np.eye(6), KEYPOINTS) for k, pose in enumerate(poses))


def corners_off(found: tuple[ObjectEstimate, ...], half_turns: bool = False) -> np.ndarray:
    """Largest error of a corner of each box, millimetres; boxes look the same after a half turn."""
    corners = body().mesh.vertices[:8]
    turns = [np.diag(d) for d in ((1, 1, 1, 1), (1, -1, -1, 1), (-1, 1, -1, 1), (-1, -1, 1, 1))]
    errors = [
        [np.abs(se3.act(e.camera_from_object @ turn, corners) - se3.act(pose, corners)).max() for turn in turns]
        for e, pose in zip(found, truth(), strict=True)
    ]
    return 1e3 * np.array(errors).min(axis=1) if half_turns else 1e3 * np.array(errors)[:, 0]


def wedge() -> Mesh:
    """The box, one end of which is three tenths as high and deep: half turns show."""
    corners = box().vertices.copy()
    corners[corners[:, 0] > 0, 1:] *= 0.3
    return Mesh(corners, box().faces)


def too_far(poses: np.ndarray, factor: float) -> np.ndarray:
    moved = poses.copy()
    moved[:, :3, 3] *= factor
    return moved


@pytest.mark.parametrize("factor", [0.85, 1.0, 1.12, 1.25])
def test_wrong_distances_and_attitudes_are_put_right(rng: np.random.Generator, factor: float) -> None:
    turned = truth() @ se3.exp(np.array([0.1, -0.12, 0.1, 0, 0, 0]))
    start = estimates(too_far(turned, factor))
    (found,) = fitter().fit([seen(rng)], [start])
    assert corners_off(start).min() > 5
    assert corners_off(found, half_turns=True).max() < 5
    for each in found:
        # Keypoints that were wrong have no say any more, and bars are finite and not absurd.
        assert each.detection is None and each.covariance is not None
        std = np.sqrt(np.diag(each.covariance))
        assert (std[:3] >= 0.02).all() and (std[3:] >= 0.003).all() and std.max() < 0.1


@pytest.mark.parametrize("axis", [1, 2])
def test_a_part_whose_ends_were_taken_for_each_other_is_turned_round(rng: np.random.Generator, axis: int) -> None:
    mesh = wedge()
    pose = se3.exp(np.array([0.5, 0.6, 0.3, 0.0, 0.0, 0.0]))
    pose[:3, 3] = [0.03, -0.02, 0.5]
    drawn = render_depth(mesh, CAMERA, pose)
    image = np.where((drawn > 0)[..., None], COLORS[0], WALL) + rng.normal(scale=8, size=(*drawn.shape, 3))
    frame = Frame("left", 0, image.clip(0, 255).astype(np.uint8), CAMERA, None, np.where(drawn > 0, drawn, 1.0))
    turned = pose @ np.diag(np.where(np.arange(4) % 3 == axis, 1.0, [-1, -1, -1, 1]))
    known = Catalogue({1: ObjectModel(1, "wedge", mesh.diameter(), Symmetries(), mesh.box)})
    model = generate(mesh, ViewpointConfig(subdivisions=3, picture=160))
    ((found,),) = Fitter({1: Body(model, mesh)}, known, FitConfig()).fit([frame], [estimates(turned[None])])
    # Half a turn about its long axis does not show.
    same = found.camera_from_object, found.camera_from_object @ np.diag([1.0, -1, -1, 1])
    assert min(np.abs(se3.act(p, mesh.vertices) - se3.act(pose, mesh.vertices)).max() for p in same) < 5e-3


def test_what_depth_does_not_confirm_stays_as_it_is(rng: np.random.Generator) -> None:
    elsewhere = truth().copy()
    elsewhere[:, 1, 3] -= 0.25
    start = estimates(elsewhere)
    (found,) = fitter().fit([seen(rng)], [start])
    assert found == start
    hopeless = fitter(least=1.1, enough=2.0)
    assert hopeless.fit([seen(rng)], [estimates(truth())])[0][0].detection is KEYPOINTS


def test_frames_without_depth_and_unknown_objects_stay_as_they_are(rng: np.random.Generator) -> None:
    start = estimates(too_far(truth(), 1.1))
    blind = seen(rng, depth=False)
    strange = tuple(replace(each, obj_id=9) for each in start)
    nothing = replace(seen(rng), depth=np.zeros((CAMERA.height, CAMERA.width), np.float32))
    answer = fitter().fit([blind, seen(rng), nothing, seen(rng)], [start, strange, start, ()])
    assert answer == [start, strange, start, ()]


def test_an_estimate_that_depth_confirms_is_not_sought_elsewhere(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    tool, starts = fitter(), []
    real = tool._track
    monkeypatch.setattr(tool, "_track", lambda *each: (starts.append(1), real(*each))[1])
    # The third box is hidden in part.
    tool.fit([seen(rng)], [estimates(truth())[:2]])
    # Once, and once more with colours learnt where it ended.
    assert len(starts) == 2 * 2


def test_limits_that_contradict_each_other_are_refused() -> None:
    for wrong, name in (
        ({"confirms": 0.02}, "fit.confirms"),
        ({"least": 0.95}, "fit.least"),
        ({"least": 0.0}, "least"),
    ):
        with pytest.raises(ConfigError, match=name):
            FitConfig(**wrong)
