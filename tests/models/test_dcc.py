import math

import pytest
import torch

from models.dcc import ENLARGEMENT, DynamicCoordinateClassifier, GatedAttentionUnit, instance_size


def classifier(bins: int = 256) -> DynamicCoordinateClassifier:
    torch.manual_seed(0)
    return DynamicCoordinateClassifier(32, 8, bins).eval()


def some_instances(count: int = 5) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    torch.manual_seed(1)
    low = torch.rand(count, 2) * 50
    boxes = torch.cat((low, low + 10 + torch.rand(count, 2) * 40), dim=1)
    return torch.randn(count, 32), boxes, low + 7


def test_bins_span_the_enlarged_box() -> None:
    vectors, _, centres = some_instances(1)
    out = classifier()(vectors, torch.tensor([[10.0, 20.0, 30.0, 60.0]]), centres)
    assert out.bins_x.shape == (1, 256)
    assert math.isclose(out.bins_x[0, 0].item(), 20 - 10 * ENLARGEMENT, abs_tol=1e-4)
    assert math.isclose(out.bins_x[0, -1].item(), 20 + 10 * ENLARGEMENT, abs_tol=1e-4)
    assert math.isclose(out.bins_y[0, -1].item(), 40 + 20 * ENLARGEMENT, abs_tol=1e-4)


def test_heat_maps_compare_features_with_linearly_mapped_sine_encodings() -> None:
    dcc = classifier(bins=16)
    vectors, boxes, centres = some_instances()
    out = dcc(vectors, boxes, centres)
    features = dcc.mix(dcc.norm(dcc.to_features(vectors)).unflatten(1, (8, 128)))
    angles = (out.bins_y - centres[:, 1:])[..., None] * 300.0 ** -(torch.arange(64) / 64)
    encoded = dcc.encode_y(torch.cat((angles.cos(), angles.sin()), dim=-1))
    assert torch.allclose(out.heat_y, (features @ encoded.transpose(1, 2)).softmax(dim=2), atol=1e-5)


def test_keypoints_and_variance_are_the_moments_of_the_heat_maps() -> None:
    out = classifier()(*some_instances())
    mean = torch.einsum("mkb,mb->mk", out.heat_x, out.bins_x)
    assert torch.allclose(out.keypoints[..., 0], mean, atol=1e-4)
    second = torch.einsum("mkb,mb->mk", out.heat_x, out.bins_x**2)
    assert torch.allclose(out.variance[..., 0], second - mean**2, atol=1e-2)


def test_moving_an_instance_moves_its_keypoints() -> None:
    dcc = classifier()
    vectors, boxes, centres = some_instances()
    here, there = dcc(vectors, boxes, centres), dcc(vectors, boxes + 13, centres + 13)
    assert torch.allclose(here.keypoints + 13, there.keypoints, atol=1e-3)


def test_the_joint_deviation_is_the_larger_of_heat_map_and_learned_scale() -> None:
    vectors, boxes, centres = some_instances()
    out = classifier()(vectors, boxes, centres)
    learned = 2 * math.sqrt(2) * out.sigma * instance_size(boxes)[:, None]
    expected = torch.maximum(out.variance.sqrt(), learned[..., None]).clamp(min=0.5)
    assert torch.allclose(out.std, expected, rtol=1e-5)


def test_one_row_or_none_can_be_trained_on() -> None:
    dcc = classifier().train()
    vectors, boxes, centres = some_instances(1)
    assert torch.isfinite(dcc(vectors, boxes, centres).keypoints).all()
    assert dcc(vectors[:0], boxes[:0], centres[:0]).keypoints.shape == (0, 8, 2)


def test_the_attention_unit_starts_close_to_the_identity() -> None:
    torch.manual_seed(0)
    x = torch.randn(4, 8, 128)
    assert (GatedAttentionUnit(8, 128)(x) - x).abs().max() < 0.05


def test_instance_size_is_cocos_for_squares_and_does_not_vanish_for_rods() -> None:
    square, rod = torch.tensor([0.0, 0, 20, 20]), torch.tensor([0.0, 0, 100, 1])
    assert math.isclose(instance_size(square).item(), math.sqrt(0.53 * 400), rel_tol=1e-6)
    tilted = torch.tensor([0.0, 0, 100 / math.sqrt(2), 100 / math.sqrt(2)])
    assert math.isclose(instance_size(rod).item(), instance_size(tilted).item(), rel_tol=1e-3)


@pytest.mark.parametrize("bins", [8, 9])
def test_heat_maps_compare_features_with_the_encoding_of_each_bin(bins: int) -> None:
    """The definition, bin by bin; the module takes a shorter way."""
    torch.manual_seed(0)
    classifier = DynamicCoordinateClassifier(pose_vector=16, num_keypoints=4, bins=bins).double()
    features, vectors = torch.randn(3, 4, 128).double(), torch.randn(3, 16).double()
    boxes = torch.tensor([[10.0, 20, 70, 50], [0, 0, 8, 300], [-40, 5, 60, 9]]).double()
    centres = torch.tensor([[31.5, 31.5], [3.5, 99.5], [7.5, 7.5]]).double()
    outputs = classifier.read(features, vectors, boxes, centres)
    for axis, (encode, heat, places) in enumerate(
        [
            (classifier.encode_x, outputs.heat_x, outputs.bins_x),
            (classifier.encode_y, outputs.heat_y, outputs.bins_y),
        ]
    ):
        angles = (places - centres[:, axis, None])[..., None] * classifier.frequency
        encoded = encode(torch.cat((angles.cos(), angles.sin()), dim=2))
        torch.testing.assert_close(heat, (features @ encoded.transpose(1, 2)).softmax(dim=2))
