"""Correspondence lines: a posterior worked by hand, exact gradients, and what to do where there is nothing to see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

from multicam.bundle.occlusion import Occluders
from multicam.bundle.region.colors import ColorModel, colors_at
from multicam.bundle.region.compiled import LEAST_VARIANCE, LINE, MIDDLE, SEGMENTS, SHIFTS, slide_step
from multicam.bundle.region.config import RegionConfig
from multicam.bundle.region.factor import RegionFactor
from multicam.bundle.region.lines import find_lines
from multicam.geometry import se3
from tests.bundle.box_world import COLOR_CAMERA, box_model, color_picture, constant_depth, pose
from tests.bundle.test_factors import assert_close, numeric_gradient
from tests.strategies import seeds, twists

CONFIG = RegionConfig()
K = COLOR_CAMERA.matrix
ONE = np.zeros(1, dtype=np.int64)


def found(picture: np.ndarray, at: np.ndarray, search: int = 0, colors: ColorModel | None = None, **changes):
    """Lines of the box at a pose, with the colours that are right in these pictures."""
    known = learnt() if colors is None else colors
    return find_lines(box_model(), picture, K, at, known, Occluders(), search, replace(CONFIG, **changes))


def learnt() -> ColorModel:
    picture = color_picture(np.random.default_rng(5), pose())
    return ColorModel.uniform().blended(colors_at(box_model(), picture, K, pose(), Occluders(), CONFIG), 1.0)


def factor(lines: np.ndarray, local: bool = False) -> RegionFactor:
    return RegionFactor.of_edges(ONE, ONE, K[None], [lines], CONFIG).in_update(int(local), CONFIG)


def shifts(lines: np.ndarray, camera_from_object: np.ndarray) -> np.ndarray:
    pixels = COLOR_CAMERA.project(se3.act(camera_from_object, lines["point"]))
    return np.sum(lines["direction"] * pixels, axis=1) - lines["origin"]


def random_lines(rng: np.random.Generator, count: int) -> np.ndarray:
    """Lines through the box's contour with posteriors of any shape."""
    lines = np.empty(count, LINE)
    lines["point"] = rng.uniform(-0.05, 0.05, size=(count, 3))
    normal = rng.normal(size=(count, 2))
    lines["direction"] = normal / np.linalg.norm(normal, axis=1, keepdims=True) / 4
    pixels = COLOR_CAMERA.project(se3.act(pose(), lines["point"]))
    lines["origin"] = np.sum(lines["direction"] * pixels, axis=1) + rng.uniform(-7, 7, size=count)
    lines["mean"], lines["variance"] = rng.uniform(-3, 3, size=count), rng.uniform(0.5, 6, size=count)
    lines["weight"] = rng.uniform(0.1, 2, size=count)
    likelihood = rng.uniform(0.01, 1, size=(count, SHIFTS))
    lines["likelihood"] = likelihood / likelihood.max(axis=1, keepdims=True)
    return lines


def test_the_posterior_of_a_perfect_edge_is_the_one_worked_out_by_hand() -> None:
    # The step has shares .924, .889, .699 | .301, ... of object; moving it by one segment past a perfect edge replaces
    # .699 by .301 in the product, by two also .889 by .111, by three also .924 by .0758.
    on_object = np.where(np.arange(SEGMENTS) < 10, 1.0, 0.0)
    likelihood = np.empty(SHIFTS)
    mean, variance = slide_step(on_object, likelihood)
    ratios = np.cumprod([1, 0.30129 / 0.69871, 0.11079 / 0.88921, 0.07576 / 0.92424])
    # Segments 0..9 are object: the edge lies half a segment right of the line's middle, segment 9.
    best = int(0.5 + MIDDLE)
    assert likelihood[best : best + 4] == pytest.approx(ratios, rel=1e-4)
    assert likelihood[best - 3 : best + 1] == pytest.approx(ratios[::-1], rel=1e-4)
    # The shifts end 5 to one side and 6 to the other.
    assert mean == pytest.approx(0.5, abs=2e-3)
    # Farther shifts leave the edge altogether, at .00034. So the variance is
    # (2 (1 .4312 + 4 .0537 + 9 .0044 + 41 .00034) + 36 .00034) / (1 + 2 (.4312 + .0537 + .0044 + .00068) + .00034).
    assert variance == pytest.approx(0.7126, abs=1e-3)


def test_a_line_that_sees_nothing_has_a_flat_posterior() -> None:
    likelihood = np.empty(SHIFTS)
    mean, variance = slide_step(np.full(SEGMENTS, 0.5), likelihood)
    assert likelihood == pytest.approx(np.ones(SHIFTS))
    assert mean == pytest.approx(0)
    assert variance == pytest.approx((SHIFTS**2 - 1) / 12)


def test_contradictions_leave_a_posterior_that_is_a_number() -> None:
    likelihood = np.empty(SHIFTS)
    mean, variance = slide_step(np.arange(SEGMENTS) % 2.0, likelihood)
    assert np.all(likelihood > 0) and np.isfinite(mean) and variance >= LEAST_VARIANCE


@pytest.mark.parametrize("search", [0, 1, 2, 3])
def test_the_posterior_follows_a_contour_that_is_not_where_the_pose_puts_it(
    rng: np.random.Generator, search: int
) -> None:
    moved = pose()
    # 4 pixels to the right: 4 mm at 60 cm and a focal length of 600.
    moved[0, 3] += 0.004
    lines = found(color_picture(rng, moved), pose(), search)
    expected = shifts(lines, moved)
    # Only rounding to whole pixels, half of one along the axis that a line follows.
    assert np.abs(shifts(lines, pose())).max() <= 0.5001 / CONFIG.scale(search)
    near = np.abs(expected) < 4
    assert near.sum() > 60
    assert np.median(np.abs(lines["mean"] - expected)[near]) < 0.35


@given(seeds(), twists(most=0.05, reach=0.005))
def test_the_local_gradient_is_that_of_the_energy_times_gain_over_variance(
    rng: np.random.Generator, difference: np.ndarray
) -> None:
    at = se3.plus(pose(), difference)[None]
    line = random_lines(rng, 1)
    place = shifts(line, at[0])[0] + MIDDLE
    numeric = numeric_gradient(factor(line).linearize, at) * CONFIG.gain / line["variance"][0]
    # Between two shifts the energy is a straight line; at a shift it has a kink.
    if 0 < place < SHIFTS - 1 and abs(place - round(place)) > 1e-3:
        assert_close(factor(line, local=True).linearize(at).gradient[0], numeric)
    elif not 0 < place < SHIFTS - 1:
        assert not np.any(numeric) and not np.any(factor(line, local=True).linearize(at).gradient)


def numeric_normal_gradient(lines: np.ndarray, moved) -> np.ndarray:
    """Central differences of sum w (d - mean)^2 / (2 variance) over poses moved(xi)."""

    def energy(xi: np.ndarray) -> float:
        error = shifts(lines, moved(xi)) - lines["mean"]
        return float(np.sum(lines["weight"] * error**2 / lines["variance"]) / 2)

    steps = 1e-6 * np.eye(6)
    return np.array([(energy(s) - energy(-s)) / 2e-6 for s in steps])


@given(seeds(), twists(most=0.05, reach=0.005))
def test_the_global_gradient_is_that_of_normal_distributions_moved_on_either_side(
    rng: np.random.Generator, difference: np.ndarray
) -> None:
    at = se3.plus(pose(), difference)
    lines = random_lines(rng, 20)
    gradient = factor(lines).linearize(at[None]).gradient[0]
    assert_close(gradient, numeric_normal_gradient(lines, lambda xi: se3.plus(at, xi)))
    # exp(xi) T = T exp(Ad(T^-1) xi).
    on_the_left = se3.adjoint(se3.inverse(at)).T @ gradient
    assert_close(on_the_left, numeric_normal_gradient(lines, lambda xi: se3.exp(xi) @ at))


@given(seeds())
def test_the_hessian_is_exact_where_each_shift_is_its_mean(rng: np.random.Generator) -> None:
    lines = random_lines(rng, 20)
    lines["mean"] = shifts(lines, pose())
    numeric = np.array(
        [
            (
                factor(lines).linearize(se3.plus(pose(), s)[None]).gradient[0]
                - factor(lines).linearize(se3.plus(pose(), -s)[None]).gradient[0]
            )
            / 2e-6
            for s in 1e-6 * np.eye(6)
        ]
    )
    assert_close(factor(lines).linearize(pose()[None]).hessian[0], numeric)


@settings(max_examples=10)
@given(seeds(), twists(most=0.03, reach=0.004))
def test_the_energy_falls_along_the_step(rng: np.random.Generator, difference: np.ndarray) -> None:
    start = se3.plus(pose(), difference)
    lines = found(color_picture(rng, pose()), start, search=1)
    for local in (False, True):
        region = factor(lines, local)
        here = region.linearize(start[None])
        step = np.linalg.solve(here.hessian[0] + np.diag([1000.0] * 3 + [30000.0] * 3), -here.gradient[0])
        if np.abs(step).max() > 1e-4:
            assert region.linearize(se3.plus(start, step / 2)[None]).energy[0] < here.energy[0]


def test_edges_know_nothing_of_each_other(rng: np.random.Generator) -> None:
    first, second = random_lines(rng, 7), random_lines(rng, 12)
    poses = np.stack((pose(), se3.plus(pose(), np.array([0.1, 0, 0, 0, 0, 0.02]))))
    both = np.array([0, 1])
    joint = RegionFactor.of_edges(both, both, np.stack((K, K)), [first, second], CONFIG).linearize(poses)
    for e, lines in enumerate((first, second)):
        alone = factor(lines).linearize(poses[e : e + 1])
        assert joint.energy[e] == alone.energy[0]
        assert np.array_equal(joint.gradient[e], alone.gradient[0])
        assert np.array_equal(joint.hessian[e], alone.hessian[0])


def test_a_pose_behind_the_camera_has_infinite_energy(rng: np.random.Generator) -> None:
    behind = pose()
    behind[2, 3] = -0.6
    answer = factor(random_lines(rng, 5)).linearize(behind[None])
    assert np.isinf(answer.energy[0]) and not np.any(answer.gradient)


def test_a_turned_picture_gives_the_same_answer(rng: np.random.Generator) -> None:
    # The picture is turned by 90 degrees, and with it the camera matrix.
    picture = color_picture(rng, pose())
    turn = np.array([[0, -1, 479.0], [1, 0, 0], [0, 0, 1]])
    turned = np.ascontiguousarray(np.rot90(picture, -1))
    lines = find_lines(box_model(), turned, turn @ K, pose(), learnt(), Occluders(), 3, CONFIG)
    straight = found(picture, pose(), 3)
    # Lines in the object's frame are other lines, for normals follow the camera's axes; only the count is the same.
    assert len(lines) == len(straight) > 0


def test_an_object_too_thin_for_a_coarse_search_is_searched_at_the_next_finer_scale(rng: np.random.Generator) -> None:
    thin = pose()
    thin[2, 3] = 3.0
    picture = color_picture(rng, thin)
    known = ColorModel.uniform().blended(colors_at(box_model(), picture, K, thin, Occluders(), CONFIG), 1.0)
    counts = [len(found(picture, thin, search, known)) for search in range(4)]
    enough = next(search for search, count in enumerate(counts) if 2 * count >= CONFIG.lines)
    assert enough > 0 and counts[0] > 0
    lines = find_lines(box_model(), picture, K, thin, known, Occluders(), 0, CONFIG, finer=True)
    assert np.array_equal(lines, found(picture, thin, enough, known))
    # Nothing is finer than the finest.
    gone = pose()
    gone[:3, 3] = [5.0, 0, 0.6]
    for search in (0, 3, 9):
        assert len(find_lines(box_model(), picture, K, gone, known, Occluders(), search, CONFIG, finer=True)) == 0


@pytest.mark.parametrize("place", [[5.0, 0, 0.6], [0, 0, -0.6], [0, 0, 0.0]])
def test_an_object_out_of_sight_has_no_lines(rng: np.random.Generator, place: list[float]) -> None:
    gone = pose()
    gone[:3, 3] = place
    lines = found(color_picture(rng, pose()), gone)
    assert len(lines) == 0
    answer = factor(lines).linearize(gone[None])
    assert answer.energy[0] == 0 and not np.any(answer.gradient) and not np.any(answer.hessian)


def test_an_object_that_is_all_hidden_has_no_lines_and_no_colours(rng: np.random.Generator) -> None:
    hidden, picture = Occluders((constant_depth(0.3),)), color_picture(rng, pose())
    assert len(find_lines(box_model(), picture, K, pose(), learnt(), hidden, 0, CONFIG)) == 0
    assert not colors_at(box_model(), picture, K, pose(), hidden, CONFIG).any()


def test_a_picture_without_texture_says_nothing_of_the_pose() -> None:
    gray = np.full((480, 640, 3), 128, dtype=np.uint8)
    counts = colors_at(box_model(), gray, K, pose(), Occluders(), CONFIG)
    lines = found(gray, pose(), 2, ColorModel.uniform().blended(counts, 1.0))
    assert lines["likelihood"] == pytest.approx(np.ones((len(lines), SHIFTS)))
    assert not np.any(factor(lines, local=True).linearize(pose()[None]).gradient)
    here = factor(lines).linearize(pose()[None])
    # The global model draws each line to its middle pixel: far less than one pixel of 1 mm.
    step = np.linalg.solve(here.hessian[0] + np.diag([1000.0] * 3 + [30000.0] * 3), -here.gradient[0])
    assert np.abs(step[3:]).max() < 2e-4


def test_lines_across_a_silhouette_thinner_than_they_need_are_left_out(rng: np.random.Generator) -> None:
    picture = color_picture(rng, pose())
    # The box is about 100 pixels wide: 3 segments of 6 pixels fit, 30 do not.
    assert len(found(picture, pose(), clear=3.0)) > 100
    assert len(found(picture, pose(), clear=30.0)) == 0


def test_colours_are_told_apart_and_the_unseen_are_undecided(rng: np.random.Generator) -> None:
    picture = color_picture(rng, pose(), noise=0.0)
    counts = colors_at(box_model(), picture, K, pose(), Occluders(), CONFIG)
    colors = ColorModel.uniform().blended(counts, 1.0)
    assert colors.inside.sum() == pytest.approx(1) and colors.outside.sum() == pytest.approx(1)
    box_bin, wall_bin = (200 >> 4) << 8 | (60 >> 4) << 4 | 40 >> 4, (60 >> 4) << 8 | (90 >> 4) << 4 | 180 >> 4
    # Pixels of the contour itself may fall on either side.
    assert colors.posterior[box_bin] > 0.95 and colors.posterior[wall_bin] < 0.05
    assert colors.posterior[0] == 0.5


def test_colours_blend_at_their_rate_and_nothing_new_changes_nothing() -> None:
    old, new = ColorModel.uniform(), np.zeros((2, 4096))
    new[0, 7] = 50
    blended = old.blended(new, 0.2)
    assert blended.inside[7] == pytest.approx(0.8 / 4096 + 0.2)
    assert np.array_equal(blended.outside, old.outside)
