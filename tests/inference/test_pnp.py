"""PnP: exact without noise, honest covariance, outliers, ambiguity, and plain refusals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from multicam.geometry import se3, so3
from multicam.geometry.camera import Camera
from multicam.inference import reprojection
from multicam.inference.pnp import PnpConfig, PnpRefusal, PnpSolution, solve_pnp

CAMERA = Camera(np.array([[620.0, 0, 330], [0, 600, 235], [0, 0, 1]]), 640, 480)
CUBE = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.04, 0.04) for z in (-0.06, 0.06)])
CONFIG = PnpConfig()
seeds = st.integers(0, 2**32 - 1)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    shift = [rng.uniform(-0.15, 0.15), rng.uniform(-0.1, 0.1), rng.uniform(0.4, 1.0)]
    return se3.from_parts(so3.random(rng), np.array(shift))


def picture(pose: np.ndarray, points: np.ndarray, camera: Camera = CAMERA) -> np.ndarray:
    return camera.project(se3.act(pose, points))


def solve(
    pixels: np.ndarray,
    points: np.ndarray = CUBE,
    std: float = 0.5,
    camera: Camera = CAMERA,
    config: PnpConfig = CONFIG,
) -> PnpSolution | PnpRefusal:
    return solve_pnp(pixels, np.full(pixels.shape, std), np.ones(len(points)), points, camera, config)


def solved(*args: object, **kwargs: object) -> PnpSolution:
    answer = solve(*args, **kwargs)  # pyright: ignore[reportArgumentType]
    assert isinstance(answer, PnpSolution), answer
    return answer


def refused(answer: PnpSolution | PnpRefusal) -> str:
    assert isinstance(answer, PnpRefusal)
    return answer.reason


@given(seeds)
def test_exact_keypoints_give_the_exact_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose, points = random_pose(rng), rng.uniform(-0.08, 0.08, (8, 3))
    answer = solved(picture(pose, points), points)
    np.testing.assert_allclose(answer.camera_from_object, pose, atol=1e-6)
    assert answer.inliers.all()
    assert answer.error_px < 1e-5


@given(seeds)
def test_exact_keypoints_of_a_flat_object_give_the_exact_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    flat = np.c_[rng.uniform(-0.1, 0.1, (8, 2)), np.zeros(8)]
    pose = random_pose(rng)
    if abs(pose[:3, 2] @ pose[:3, 3]) / np.linalg.norm(pose[:3, 3]) < 0.2:
        return  # Seen edge-on a plane is a line.
    np.testing.assert_allclose(solved(picture(pose, flat), flat).camera_from_object, pose, atol=1e-5)


@given(seeds)
def test_lens_distortion_is_undone(seed: int) -> None:
    camera = Camera(CAMERA.matrix, 640, 480, (-0.2, 0.05, 1e-3, -5e-4, 0.01))
    pose = random_pose(np.random.default_rng(seed))
    answer = solved(picture(pose, CUBE, camera), camera=camera)
    np.testing.assert_allclose(answer.camera_from_object, pose, atol=1e-6)


@given(seeds)
def test_the_jacobian_equals_central_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose, std = random_pose(rng), rng.uniform(0.5, 3, (8, 2))
    matrix = np.array([[600, 20, 320], [-10, 640, 240], [0, 0, 1.0]])
    pixels = rng.uniform(0, 400, (8, 2))

    def residuals(xi: np.ndarray) -> np.ndarray:
        return reprojection.residuals(se3.plus(pose, xi), CUBE, pixels, std, matrix)

    step = 1e-6
    columns = [(residuals(step * axis) - residuals(-step * axis)) / (2 * step) for axis in np.eye(6)]
    analytic = reprojection.jacobian(pose, CUBE, std, matrix)
    np.testing.assert_allclose(analytic, np.stack(columns, axis=-1), rtol=1e-5, atol=1e-4)


def test_the_gradient_is_that_of_half_the_huber_cost() -> None:
    rng = np.random.default_rng(5)
    pose = random_pose(rng)
    pixels = picture(pose, CUBE) + rng.normal(size=(8, 2)) * 3
    rest = (CUBE, pixels, np.ones((8, 2)), CAMERA.matrix)

    def cost(xi: np.ndarray) -> float:
        return reprojection.huber_cost(reprojection.residuals(se3.plus(pose, xi), *rest), 2.45)

    numeric = [(cost(1e-6 * a) - cost(-1e-6 * a)) / 4e-6 for a in np.eye(6)]
    gradient, _ = reprojection.information(pose, *rest, 2.45)
    np.testing.assert_allclose(gradient, numeric, rtol=1e-4, atol=1e-3)


def test_huber_cost_of_hand_worked_residuals() -> None:
    # Norm 1 counts squared; norm 5 beyond k = 2 counts 2 * 2 * 5 - 4 = 16.
    assert reprojection.huber_cost(np.array([[1.0, 0], [3, 4]]), 2.0) == pytest.approx(17)


def test_covariance_is_calibrated() -> None:
    """The normalised squared error of 6 degrees of freedom averages 6, less the inflation's caution."""
    rng = np.random.default_rng(1)
    nees, depth_errors, depth_variances = [], [], []
    for _ in range(400):
        pose = random_pose(rng)
        std = rng.uniform(0.5, 1.5, (8, 2))
        pixels = picture(pose, CUBE) + rng.normal(size=(8, 2)) * std
        answer = solve_pnp(pixels, std, np.ones(8), CUBE, CAMERA, CONFIG)
        assert isinstance(answer, PnpSolution)
        error = se3.minus(pose, answer.camera_from_object)
        nees.append(error @ np.linalg.solve(answer.covariance, error))
        in_camera = answer.camera_from_object[2, :3]
        depth_errors.append(in_camera @ error[3:])
        depth_variances.append(in_camera @ answer.covariance[3:, 3:] @ in_camera)
    assert 4.5 < np.mean(nees) < 6.8
    assert 0.8 < np.mean(np.square(depth_errors)) / np.mean(depth_variances) < 1.2


def test_covariance_grows_when_the_predicted_std_is_too_small() -> None:
    rng = np.random.default_rng(2)
    pose = random_pose(rng)
    pixels = picture(pose, CUBE) + rng.normal(size=(8, 2)) * 1.8
    proud, modest = solved(pixels, std=0.5), solved(pixels, std=1.5)
    assert proud.chi2_per_dof > 1.5
    assert modest.chi2_per_dof < 1
    # The model alone would make the variances differ by 9.
    ratio = np.trace(modest.covariance[3:, 3:]) / np.trace(proud.covariance[3:, 3:])
    assert ratio == pytest.approx(9 / proud.chi2_per_dof, rel=0.15)


def test_keypoints_that_are_wrong_together_do_not_make_a_pose_precise() -> None:
    """Each is as wrong as its deviation says, but all are where a pose that is a little off puts them."""
    rng = np.random.default_rng(4)
    std, nees = np.full((8, 2), 4.0), []
    for _ in range(300):
        pose = random_pose(rng)
        # The spread of poses that explains all of the deviations: 16 coordinates by 6 numbers.
        rows = reprojection.jacobian(pose, CUBE, std, CAMERA.matrix).reshape(16, 6)
        spread = np.linalg.cholesky(np.linalg.inv(rows.T @ rows) * 16 / 6)
        seen = picture(se3.plus(pose, spread @ rng.normal(size=6)), CUBE)
        answer = solve_pnp(seen, std, np.ones(8), CUBE, CAMERA, CONFIG)
        assert isinstance(answer, PnpSolution)
        error = se3.minus(pose, answer.camera_from_object)
        nees.append(error @ np.linalg.solve(answer.covariance, error))
    # Independent errors would leave 16 on average.
    assert 5.0 < np.mean(nees) < 7.5


def test_covariance_is_never_smaller_than_the_model_says() -> None:
    pose = random_pose(np.random.default_rng(3))
    pixels = picture(pose, CUBE)
    small, large = solved(pixels, std=1.0).covariance, solved(pixels, std=2.0).covariance
    np.testing.assert_allclose(large[3:, 3:], 4 * small[3:, 3:], rtol=0.05)
    assert np.all(np.linalg.eigvalsh(small) > 0)
    np.testing.assert_array_equal(small, small.T)


@given(seeds, st.sampled_from([1, 2, 3]), st.booleans())
@settings(max_examples=100)
def test_gross_errors_of_up_to_three_in_eight_are_survived(seed: int, count: int, conspire: bool) -> None:
    rng = np.random.default_rng(seed)
    points = CUBE + rng.uniform(-0.01, 0.01, CUBE.shape)
    pose = random_pose(rng)
    clean = picture(pose, points) + rng.normal(size=(8, 2)) * 0.3
    wrong = rng.choice(8, count, replace=False)
    angle = rng.uniform(0, 2 * np.pi, 1 if conspire else count)
    dirty = clean.copy()
    dirty[wrong] += 40 * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    answer = solved(dirty, points)
    assert not answer.inliers[wrong].any()
    assert answer.inliers.sum() == 8 - count
    error = se3.minus(pose, answer.camera_from_object)
    assert error @ np.linalg.solve(answer.covariance, error) < 60


@given(seeds)
def test_small_objects_in_long_lenses_are_solved(seed: int) -> None:
    """OpenCV's SQPnP stops with an assertion there."""
    rng = np.random.default_rng(seed)
    camera, pose = Camera.from_focal(10_000.0, 640, 480), random_pose(rng)
    pose[:3, 3] = [0.1, 0.0, 30.0]
    answer = solved(picture(pose, CUBE, camera), camera=camera)
    candidates = [answer.camera_from_object] + ([] if answer.twin is None else [answer.twin])
    assert min(np.abs(found - pose).max() for found in candidates) < 1e-3


def test_a_twin_is_reported_for_a_small_flat_object_far_away() -> None:
    flat = np.array([[x, y, 0] for x in (-0.02, 0, 0.02) for y in (-0.02, 0, 0.02)])
    pose = se3.from_parts(so3.exp(np.array([0.6, 0, 0])), np.array([0, 0, 1.5]))
    answer = solved(picture(pose, flat), flat, std=1.0)
    assert answer.twin is not None
    np.testing.assert_allclose(answer.camera_from_object, pose, atol=1e-4)
    mirrored = so3.exp(np.array([-0.6, 0, 0]))
    assert np.linalg.norm(so3.log(answer.twin[:3, :3].T @ mirrored)) < 0.1


def test_no_twin_is_reported_for_a_solid_object_close_by() -> None:
    pose = random_pose(np.random.default_rng(4))
    assert solved(picture(pose, CUBE)).twin is None


@given(seeds, st.sampled_from([0.5, 2.0, 4.0]))
def test_scaling_the_image_with_its_camera_changes_nothing(seed: int, factor: float) -> None:
    rng = np.random.default_rng(seed)
    pixels = picture(random_pose(rng), CUBE) + rng.normal(size=(8, 2)) * 0.5
    scaled = Camera(np.diag([factor, factor, 1]) @ CAMERA.matrix, round(640 * factor), round(480 * factor))
    config = PnpConfig(std_floor=0.5 * factor, max_error_px=4 * factor)
    one, other = solved(pixels), solved(pixels * factor, std=0.5 * factor, camera=scaled, config=config)
    np.testing.assert_allclose(other.camera_from_object, one.camera_from_object, atol=1e-5)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-3, atol=1e-9)
    assert other.error_px == pytest.approx(one.error_px * factor, rel=1e-4)


def test_an_object_behind_the_camera_is_refused() -> None:
    rng = np.random.default_rng(6)
    for _ in range(20):
        pose = random_pose(rng)
        pose[:3, 3] = [0.02, 0.01, -0.25]
        points = rng.uniform(-0.08, 0.08, (8, 3))
        reason = refused(solve(picture(pose, points), points, config=PnpConfig(min_inliers=7)))
        assert "agree" in reason or "front" in reason


def test_keypoints_on_one_line_are_refused() -> None:
    line = np.linspace(-0.1, 0.1, 8)[:, None] * np.array([1.0, 2, 3])
    pose = random_pose(np.random.default_rng(7))
    assert "line" in refused(solve(picture(pose, line), line))


def test_a_thin_rod_gets_a_pose_whose_roll_is_left_open() -> None:
    rng = np.random.default_rng(8)
    rod = np.c_[np.linspace(-0.12, 0.12, 8), rng.uniform(-2.5e-4, 2.5e-4, (8, 2))]
    pose = se3.from_parts(so3.exp(np.array([0.3, 0.4, 0.5])), np.array([0, 0, 0.7]))
    answer = solved(picture(pose, rod) + rng.normal(size=(8, 2)) * 0.7, rod, std=0.7)
    roll, pitch, yaw = np.sqrt(np.diag(answer.covariance)[:3])
    assert roll > 3 * max(pitch, yaw)
    assert roll <= np.pi / np.sqrt(3) + 1e-9


def test_scattered_keypoints_are_refused() -> None:
    pixels = np.random.default_rng(9).uniform(0, 400, (8, 2))
    assert "agree" in refused(solve(pixels))


def test_collapsed_keypoints_are_refused() -> None:
    assert "span" in refused(solve(np.full((8, 2), 200.0)))


def test_keypoints_that_are_not_finite_are_left_out() -> None:
    pose = random_pose(np.random.default_rng(10))
    pixels = picture(pose, CUBE)
    pixels[2] = np.nan
    answer = solved(pixels)
    assert not answer.inliers[2]
    assert answer.inliers.sum() == 7
    pixels[:4] = np.nan
    assert "only 4 of 8" in refused(solve(pixels))


def test_an_object_hidden_from_view_is_refused() -> None:
    pixels = picture(random_pose(np.random.default_rng(11)), CUBE)
    answer = solve_pnp(pixels, np.ones((8, 2)), np.full(8, 0.05), CUBE, CAMERA, CONFIG)
    assert "visible" in refused(answer)


def test_inaccurate_keypoints_are_refused_with_their_error() -> None:
    rng = np.random.default_rng(12)
    pixels = picture(random_pose(rng), CUBE) + rng.normal(size=(8, 2)) * 16
    assert "reprojection error" in refused(solve(pixels, std=12.0))


def test_keypoints_may_be_as_inaccurate_as_they_say_up_to_a_share_of_the_object() -> None:
    rng = np.random.default_rng(13)
    pose = np.eye(4)
    pose[:3, 3] = [0.0, 0.0, 0.35]
    pixels = picture(pose, CUBE) + rng.normal(size=(8, 2)) * 7
    assert solved(pixels, std=10.0).error_px > 5
    # Told to be exact, or small in the picture.
    assert "reprojection error" in refused(solve(pixels, std=10.0, config=PnpConfig(max_stated_fraction=0.0)))
    pose[2, 3] = 1.5
    assert "reprojection error" in refused(solve(picture(pose, CUBE) + rng.normal(size=(8, 2)) * 10, std=10.0))


def test_a_configuration_that_cannot_fix_a_pose_is_refused() -> None:
    with pytest.raises(ValueError, match="min_inliers"):
        PnpConfig(min_inliers=3)
    with pytest.raises(ValueError, match="max_stated_fraction"):
        PnpConfig(max_stated_fraction=-0.1)
