import pytest
import torch

from models.blocks import RepBlock
from models.config import ModelConfig
from models.detector import Detector, count_parameters

VARIANTS = [
    ModelConfig(3, "nano"),
    ModelConfig(3, "nano", strides=(16, 32)),
    ModelConfig(3, "nano", depthwise=True),
    ModelConfig(2, "tiny", "hybrid", num_keypoints=9),
    ModelConfig(2, "tiny", "hybrid", strides=(16, 32), bins=64),
]


def build(config: ModelConfig, seed: int = 0) -> Detector:
    torch.manual_seed(seed)
    return Detector(config)


def with_lively_statistics(detector: Detector) -> Detector:
    """Running statistics of a fresh network are trivial, and folding trivial numbers proves nothing."""
    for module in detector.modules():
        if isinstance(module, torch.nn.BatchNorm2d | torch.nn.BatchNorm1d):
            torch.nn.init.uniform_(module.running_mean, -0.2, 0.2)
            torch.nn.init.uniform_(module.running_var, 0.5, 2.0)
            torch.nn.init.uniform_(module.weight, 0.5, 1.5)
            torch.nn.init.uniform_(module.bias, -0.2, 0.2)
    return detector.eval()


@pytest.mark.parametrize("config", VARIANTS)
def test_raw_outputs_have_one_row_per_cell_of_every_level(config: ModelConfig) -> None:
    raw = build(config).eval()(torch.rand(2, 3, 96, 128) * 255)
    cells = sum((96 // s) * (128 // s) for s in config.strides)
    k = config.num_keypoints
    assert raw.class_logits.shape == (2, cells, config.num_classes)
    assert raw.boxes.shape == (2, cells, 4)
    assert raw.proxy.shape == (2, cells, k, 2)
    assert raw.visibility_logits.shape == (2, cells, k)
    assert raw.pose_vectors.shape == (2, cells, config.pose_vector)
    assert raw.centres.shape == (cells, 2) and raw.strides.shape == (cells,)


def test_cell_centres_follow_the_pixel_centre_convention() -> None:
    raw = build(ModelConfig(1)).eval()(torch.zeros(1, 3, 64, 96))
    # Stride 8, row 0: columns 0 and 1; the next row starts after 96 / 8 cells.
    assert raw.centres[0].tolist() == [3.5, 3.5]
    assert raw.centres[1].tolist() == [11.5, 3.5]
    assert raw.centres[12].tolist() == [3.5, 11.5]
    assert raw.strides[0] == 8 and raw.strides[-1] == 32
    assert raw.centres[-1].tolist() == [2.5 * 32 - 0.5, 1.5 * 32 - 0.5]


def test_a_new_network_expects_boxes_around_its_cells_and_almost_no_objects() -> None:
    raw = build(ModelConfig(4)).eval()(torch.rand(1, 3, 64, 64) * 255)
    assert raw.class_logits.sigmoid().max() < 0.1
    middle = (raw.boxes[..., :2] + raw.boxes[..., 2:]) / 2
    assert ((middle - raw.centres).abs().amax(-1) < raw.strides).all()


def test_the_outputs_move_with_the_picture_by_whole_strides() -> None:
    detector = build(ModelConfig(2)).eval()
    picture = torch.full((1, 3, 256, 256), 114.0)
    picture[:, :, 96:128, 96:128] = torch.rand(1, 3, 32, 32) * 255
    moved = picture.roll((32, 32), (2, 3))
    first, second = detector(picture), detector(moved)
    cell = 13 * 32 + 13
    # Far from the border the same cell, four strides further on, sees the same neighbourhood.
    assert torch.allclose(first.boxes[0, cell] + 32, second.boxes[0, cell + 4 * 32 + 4], atol=0.5)


@pytest.mark.parametrize("config", VARIANTS)
def test_fusing_changes_the_graph_and_not_the_numbers(config: ModelConfig) -> None:
    detector = with_lively_statistics(build(config))
    fused = detector.fuse()
    assert not any(isinstance(m, torch.nn.BatchNorm2d | torch.nn.BatchNorm1d) for m in fused.modules())
    assert all(m.narrow is None for m in fused.modules() if isinstance(m, RepBlock))
    images = torch.rand(1, 3, 64, 96) * 255
    raw, of_fused = detector(images), fused(images)
    # The same cells for both decoders: where two score alike, rounding says which comes first.
    decoded = zip(detector.decode(raw, 5), fused.decode(raw, 5), strict=True)
    for a, b in [*zip(raw, of_fused, strict=True), *decoded]:
        assert torch.allclose(a.float(), b.float(), rtol=1e-3, atol=1e-2)


def test_decoding_keeps_the_best_cells_in_order_and_reads_their_own_keypoints() -> None:
    detector = with_lively_statistics(build(ModelConfig(3)))
    raw = detector(torch.rand(2, 3, 64, 64) * 255)
    decoded = detector.decode(raw, 7)
    best = raw.class_logits.sigmoid().amax(2).sort(dim=1, descending=True)
    assert torch.allclose(decoded.scores, best.values[:, :7])
    cell = int(best.indices[1, 3])
    alone = detector.dcc(
        raw.pose_vectors[1, cell : cell + 1], raw.boxes[1, cell : cell + 1], raw.centres[cell : cell + 1]
    )
    assert torch.allclose(decoded.keypoints[1, 3], alone.keypoints[0], atol=1e-3)
    assert torch.allclose(decoded.std[1, 3], alone.std[0], rtol=1e-3)
    assert decoded.labels[1, 3] == raw.class_logits[1, cell].argmax()


def test_the_smallest_network_takes_about_ten_megabytes() -> None:
    assert 4 * count_parameters(build(ModelConfig(9, "nano"))) < 10.5e6


def test_unknown_sizes_and_strides_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown model size"):
        ModelConfig(1, "huge")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="strides must be"):
        ModelConfig(1, strides=(4, 8))
