"""Networks as YOLOX publishes them: the file is written here, by a network that computes as YOLOX does."""

import shutil
from dataclasses import replace
from pathlib import Path

import onnx
import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.config import ModelConfig
from models.detector import Detector
from multicam.config import load_config
from multicam.errors import DataError, ModelError
from multicam.files import read_json
from tests.models.test_detector import build, with_lively_statistics
from tests.train.toy_pictures import write_toy_dataset
from train.cli import main
from train.config import TrainConfig
from train.fit import fit
from train.folded import NetworkFile
from train.published import published_size, take_published

SIZES = {
    "nano": ModelConfig(3, "nano", depthwise=True),
    "tiny": ModelConfig(3, "tiny"),
    "hybrid": ModelConfig(2, "tiny", "hybrid", strides=(16, 32)),
}


class Yolox(nn.Module):
    """Backbone and neck as in YOLOX: BGR pixels from 0 to 255, the four pixels of each block side by side.

    YOLOX pads with black, which is not what our networks see as nothing; the first padding is grey here, to compare.
    """

    def __init__(self, detector: Detector) -> None:
        super().__init__()
        fused = detector.fuse()
        self.backbone, self.neck = fused.backbone, fused.neck
        wide, bias = self.backbone.stem.conv.weight, self.backbone.stem.conv.bias
        assert bias is not None
        self.first = nn.Conv2d(12, len(wide), 3)
        with torch.no_grad():
            corners = [wide[:, :, y::2, x::2].flip(1) / 64 for y, x in ((0, 0), (1, 0), (0, 1), (1, 1))]
            self.first.weight.copy_(torch.cat(corners, dim=1))
            self.first.bias.copy_(bias - 114 / 64 * wide.sum(dim=(1, 2, 3)))

    def forward(self, images: Tensor) -> list[Tensor]:
        x = F.pad(images, (2, 2, 2, 2), value=114.0)
        corners = [x[:, :, y::2, x_::2] for y, x_ in ((0, 0), (1, 0), (0, 1), (1, 1))]
        x = F.silu(self.first(torch.cat(corners, dim=1)))
        backbone = self.backbone
        at8 = backbone.stage8(backbone.stage4(x))
        at16 = backbone.stage16(at8)
        return self.neck((at8, at16, backbone.stage32(at16)))


def pictures(seed: int) -> Tensor:
    return torch.rand(4, 3, 96, 128, generator=torch.Generator().manual_seed(seed)) * 255


def publish(path: Path, config: ModelConfig) -> Yolox:
    """Writes the file, with the convolutions in the order of YOLOX's, and returns its network."""
    yolox = Yolox(with_lively_statistics(build(config, seed=1)))
    torch.onnx.export(yolox.eval(), (pictures(0)[:1].flip(1),), path, dynamo=True, external_data=False, verbose=False)
    return yolox


@pytest.fixture(scope="module")
def nano(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("published") / "yolox_nano.onnx"
    publish(path, SIZES["nano"])
    return path


@pytest.mark.parametrize("name", SIZES)
def test_backbone_and_neck_compute_what_the_published_network_computes(name: str, tmp_path: Path) -> None:
    size = SIZES[name]
    yolox = publish(tmp_path / "yolox.onnx", size)
    detector = build(size, seed=2)
    fresh = take_published(NetworkFile.read(tmp_path / "yolox.onnx"), detector, pictures(3))
    assert detector.training
    detector.eval()
    if name == "hybrid":
        # RT-DETR's neck is not YOLOX's.
        assert {n for n in fresh if n.startswith("neck")} == {n for n in detector.state_dict() if n.startswith("neck")}
        yolox.neck = detector.neck
    else:
        detector.neck.projectors = yolox.neck.projectors
        assert {n.split(".")[1] for n in fresh if n.startswith("neck")} == {"projectors"}
    assert not any(n.startswith("backbone") for n in fresh)
    # Other pictures than those of the statistics.
    images = pictures(4)
    with torch.no_grad():
        ours = detector.neck(detector.backbone((images - 114) / 64))
        theirs = yolox(images.flip(1))
    for mine, true in zip(ours, theirs, strict=True):
        assert (mine - true).abs().max() < 1e-3 * true.abs().max()


def test_a_published_network_goes_on_learning_without_a_jolt(nano: Path) -> None:
    detector, images = build(SIZES["nano"], seed=2), pictures(3)
    take_published(NetworkFile.read(nano), detector, images)
    with torch.no_grad():
        still = detector.eval().backbone((images - 114) / 64)
        learning = detector.train().backbone((images - 114) / 64)
    # Statistics of a batch are those that were taken over when the batch is the one that they are of.
    for one, other in zip(still, learning, strict=True):
        assert (one - other).abs().max() < 1e-3 * one.abs().max()


@pytest.mark.parametrize("ours", [ModelConfig(3, "nano"), ModelConfig(3, "tiny", depthwise=True), ModelConfig(3, "s")])
def test_another_size_is_refused_and_nothing_is_taken(ours: ModelConfig, nano: Path) -> None:
    detector = build(ours)
    before = {name: tensor.clone() for name, tensor in detector.state_dict().items()}
    with pytest.raises(ModelError, match=r"yolox_nano\.onnx holds a nano network; .*network\.depthwise: true, not"):
        take_published(NetworkFile.read(nano), detector, pictures(3))
    assert all(torch.equal(before[name], tensor) for name, tensor in detector.state_dict().items())


def test_what_is_no_network_is_named(tmp_path: Path) -> None:
    path = tmp_path / "yolox_nano.onnx"
    with pytest.raises(DataError, match=r"yolox_nano\.onnx"):
        take_published(NetworkFile.read(path), build(SIZES["nano"]), pictures(3))
    path.write_bytes(b"<!doctype html> not found")
    with pytest.raises(DataError, match=r"yolox_nano\.onnx is no ONNX file .*download"):
        take_published(NetworkFile.read(path), build(SIZES["nano"]), pictures(3))


def test_another_kind_of_network_is_refused(nano: Path, tmp_path: Path) -> None:
    model = onnx.load(nano)
    convolutions = [node for node in model.graph.node if node.op_type == "Conv"]
    # A YOLOX of which one layer is missing, and a network that sees whole pixels.
    for k, what in ((9, "not those of backbone and neck"), (0, "the four pixels of each block")):
        changed = onnx.ModelProto.FromString(model.SerializeToString())
        changed.graph.node.remove(convolutions[k])
        onnx.save(changed, tmp_path / "other.onnx")
        with pytest.raises(DataError, match=rf"other\.onnx is no ONNX file of a YOLOX.*{what}"):
            take_published(NetworkFile.read(tmp_path / "other.onnx"), build(SIZES["nano"]), pictures(3))


def test_a_training_begins_with_a_published_network(config: TrainConfig, nano: Path, tmp_path: Path) -> None:
    path = tmp_path / "yolox_nano.onnx"
    shutil.copy(nano, path)
    config = replace(config, initial=path, network=replace(config.network, depthwise=True))
    fit(config)
    assert read_json(config.output / "last" / "model.json")["depthwise"] is True
    # What was learnt goes on without the file.
    path.unlink()
    longer = replace(config.stages, second=replace(config.stages.first))
    assert fit(replace(config, resume=True, stages=longer)).epoch == 2


def test_a_new_configuration_takes_the_size_of_the_published_network(nano: Path, tmp_path: Path) -> None:
    write_toy_dataset(tmp_path, 3)
    file = tmp_path / "train.yaml"
    main(["new", "--models", str(tmp_path / "models"), "--initial", str(nano), "--output", str(file)])
    config = load_config(TrainConfig, file)
    assert config.initial == nano and (config.network.size, config.network.depthwise) == ("nano", True)
    assert published_size(NetworkFile.read(nano)) == ("nano", True)
