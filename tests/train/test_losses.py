"""Every loss against numbers worked out by hand."""

import math

import numpy as np
import pytest
import torch

from models.dcc import DccOutputs
from train.losses import (
    box_loss,
    class_loss,
    in_range,
    likelihood_loss,
    proxy_loss,
    ray_loss,
    visibility_loss,
)


def heat_maps(logits_x: list[float], logits_y: list[float], bins: list[float], sigma: float) -> DccOutputs:
    """One instance with one keypoint."""
    x, y = torch.tensor([[logits_x]]).float().softmax(dim=2), torch.tensor([[logits_y]]).float().softmax(dim=2)
    places = torch.tensor([bins]).float()
    empty = torch.zeros(1, 1, 2)
    return DccOutputs(empty, x, y, places, places, torch.tensor([[sigma]]), empty)


def test_box_loss_is_one_minus_squared_iou() -> None:
    a = torch.tensor([[0.0, 0, 10, 10], [0, 0, 10, 10], [0, 0, 10, 10]])
    b = torch.tensor([[0.0, 0, 10, 10], [5, 0, 15, 10], [20, 20, 30, 30]])
    # Overlaps 100/100, 50/150, 0.
    assert torch.allclose(box_loss(a, b), torch.tensor([0.0, 1 - 1 / 9, 1.0]))


def test_likelihood_of_a_certain_heat_map_is_its_laplace_density() -> None:
    # All probability in the middle bin, at 4; the target (4, 6) is 0 and 2 pixels away; size 10, sigma 0.1: scale 2.
    dcc = heat_maps([-50, 50, -50], [-50, 50, -50], [0, 4, 8], 0.1)
    loss = likelihood_loss(dcc, torch.tensor([[[4.0, 6.0]]]), torch.tensor([10.0]))
    density = (1 / 0.1) * (math.exp(-2 / 2) / 0.1)
    assert math.isclose(loss.item(), -math.log(density + 1e-4), rel_tol=1e-5)


def test_likelihood_of_a_flat_heat_map_averages_the_bins() -> None:
    dcc = heat_maps([0, 0, 0], [0, 0, 0], [0, 4, 8], 0.2)
    loss = likelihood_loss(dcc, torch.tensor([[[4.0, 0.0]]]), torch.tensor([10.0]))
    x = (1 + 2 * math.exp(-1)) / 3 / 0.2
    y = (1 + math.exp(-1) + math.exp(-2)) / 3 / 0.2
    assert math.isclose(loss.item(), -math.log(x * y + 1e-4), rel_tol=1e-5)


def test_keypoints_beyond_the_bins_do_not_count() -> None:
    dcc = heat_maps([0, 0, 0], [0, 0, 0], [0, 4, 8], 0.2)
    far = torch.tensor([[[4.0, 8.5]]])
    assert in_range(dcc, far).item() == 0
    assert likelihood_loss(dcc, far, torch.tensor([10.0])).item() == 0


def test_proxy_loss_is_one_minus_oks_plus_relative_distance() -> None:
    proxy = torch.tensor([[[3.0, 4.0], [7.0, 7.0]]])
    target = torch.tensor([[[0.0, 0.0], [7.0, 7.0]]])
    # Distance 5 at size 20 and sigma 0.05: the tolerance 2 sigma size is 2 pixels.
    expected = (1 - math.exp(-25 / (2 * 2**2)) + 7 / 20) / 2
    loss = proxy_loss(proxy, target, torch.tensor([20.0]), torch.ones(1, 2), 0.05)
    assert math.isclose(loss.item(), expected, rel_tol=1e-5)
    assert proxy_loss(proxy, target, torch.tensor([20.0]), torch.tensor([[0.0, 1.0]]), 0.05).item() == 0


def test_class_loss_weighs_background_by_its_confidence_and_objects_by_their_quality() -> None:
    logits = torch.tensor([[[0.0, math.log(3)]]])
    target = torch.tensor([[[0.0, 0.8]]])
    # Probabilities 1/2 and 3/4.
    background = 0.75 * 0.5**2 * math.log(2)
    foreground = 0.8 * -(0.8 * math.log(0.75) + 0.2 * math.log(0.25))
    loss = class_loss(logits, target, torch.ones_like(target))
    assert math.isclose(loss.item(), background + foreground, rel_tol=1e-5)
    ignored = class_loss(logits, target, torch.tensor([[[0.0, 1.0]]]))
    assert math.isclose(ignored.item(), foreground, rel_tol=1e-5)


def test_visibility_loss_is_the_mean_cross_entropy() -> None:
    logits = torch.tensor([[0.0, math.log(3)]])
    expected = (math.log(2) - math.log(0.75)) / 2
    assert math.isclose(visibility_loss(logits, torch.tensor([[1.0, 1.0]])).item(), expected, rel_tol=1e-6)


def test_ray_loss_measures_the_distance_of_points_from_rays() -> None:
    # The ray along the axis passes a point 0.02 m aside at 1 m; the diameter is 0.1 m, so |e| = 0.2 along x.
    points = torch.tensor([[[0.02, 0.0, 1.0]]])
    loss = ray_loss(torch.zeros(1, 1, 2), torch.eye(3)[None], points, torch.tensor([0.1]), torch.ones(1, 1))
    assert math.isclose(loss.item(), (50 * 0.2 - 0.5) / 50 / 3, rel_tol=1e-5)


def test_small_ray_errors_count_quadratically() -> None:
    points = torch.tensor([[[0.001, 0.0, 1.0]]])
    loss = ray_loss(torch.zeros(1, 1, 2), torch.eye(3)[None], points, torch.tensor([0.1]), torch.ones(1, 1))
    assert math.isclose(loss.item(), 25 * 0.01**2 / 3, rel_tol=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_ray_loss_does_not_change_under_an_affine_warp_with_its_camera(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = np.array([[300.0, 0, 160], [0, 310, 120], [0, 0, 1]])
    points = rng.normal(size=(2, 8, 3)) * 0.1 + (0, 0, 0.8)
    pixels = points @ camera.T
    pixels = pixels[..., :2] / pixels[..., 2:] + rng.normal(size=(2, 8, 2)) * 4
    affine = np.eye(3)
    affine[:2] += rng.normal(size=(2, 3)) * (0.3, 0.3, 20)
    warped = pixels @ affine[:2, :2].T + affine[:2, 2]

    def loss(uv: np.ndarray, matrix: np.ndarray) -> torch.Tensor:
        cameras = torch.from_numpy(np.stack([matrix] * 2))
        return ray_loss(
            torch.from_numpy(uv),
            cameras,
            torch.from_numpy(points),
            torch.tensor([0.2, 0.3]).double(),
            torch.ones(2, 8).double(),
        )

    assert torch.allclose(loss(pixels, camera), loss(warped, affine @ camera), rtol=1e-9)
    assert not torch.allclose(loss(pixels, camera), loss(warped, camera), rtol=1e-2)


def test_ray_loss_vanishes_at_the_true_projection_and_its_gradient_is_exact() -> None:
    torch.manual_seed(0)
    points = torch.randn(1, 4, 3).double() * 0.1 + torch.tensor([0, 0, 1.0]).double()
    camera = torch.tensor([[[200.0, 0, 80], [0, 200, 60], [0, 0, 1]]]).double()
    true = points @ camera[0].T
    true = true[..., :2] / true[..., 2:]
    arguments = (camera, points, torch.tensor([0.2]).double(), torch.ones(1, 4).double())
    assert ray_loss(true, *arguments).item() < 1e-20
    pixels = (true + torch.randn_like(true) * 3).requires_grad_()
    assert torch.autograd.gradcheck(lambda p: ray_loss(p, *arguments), (pixels,), atol=1e-7)


def test_the_likelihood_gradient_is_exact() -> None:
    torch.manual_seed(0)
    bins = torch.linspace(0, 20, 12).double()[None]
    target, size = torch.rand(1, 3, 2).double() * 20, torch.tensor([30.0]).double()
    empty = torch.zeros(1, 3, 2).double()

    def loss(x: torch.Tensor, y: torch.Tensor, sigma: torch.Tensor) -> torch.Tensor:
        x, y = x.softmax(dim=2), y.softmax(dim=2)
        return likelihood_loss(DccOutputs(empty, x, y, bins, bins, sigma, empty), target, size)

    inputs = [torch.randn(1, 3, 12).double().requires_grad_() for _ in range(2)]
    sigma = (torch.rand(1, 3).double() * 0.1 + 0.02).requires_grad_()
    assert torch.autograd.gradcheck(loss, (*inputs, sigma))
