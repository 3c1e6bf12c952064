"""A training begins with a network that `multicam export` has written."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from torch import Tensor

from export.half import halved
from export.to_onnx import write_onnx
from export.wrapper import DeployDetector
from models.config import ModelConfig
from models.detector import Decoded, Detector
from multicam.config import load_config
from multicam.errors import DataError, ModelError
from multicam.inference.metadata import NetworkMetadata
from multicam.inference.session import METADATA_KEY
from tests.export.conftest import HEIGHT, WIDTH, lively_detector, pictures
from tests.models.test_detector import build
from tests.toy_objects import toy_catalogue
from tests.train.toy_pictures import write_toy_dataset
from train.cli import main
from train.config import TrainConfig
from train.exported import exported_size, take_exported
from train.fit import fit
from train.folded import NetworkFile

CLASSES = len(toy_catalogue().objects)
KINDS = {
    "nano": ModelConfig(CLASSES, "nano", strides=(16, 32), bins=64),
    "depthwise": ModelConfig(CLASSES, "nano", depthwise=True, bins=64),
    "hybrid": ModelConfig(CLASSES, "tiny", "hybrid", strides=(16, 32), bins=64),
}


def written(path: Path, detector: Detector) -> NetworkFile:
    metadata = NetworkMetadata(tuple(toy_catalogue().objects.values()), WIDTH, HEIGHT, "CC0-1.0")
    write_onnx(DeployDetector(detector, 10), metadata, path)
    return NetworkFile.read(path)


@pytest.fixture(scope="module")
def nano(tmp_path_factory: pytest.TempPathFactory) -> NetworkFile:
    return written(tmp_path_factory.mktemp("exported") / "network.onnx", lively_detector(KINDS["nano"], seed=1))


def images(seed: int) -> Tensor:
    return torch.from_numpy(pictures(np.random.default_rng(seed), 4)).permute(0, 3, 1, 2).float()


def answer(detector: Detector, seen: Tensor) -> Decoded:
    with torch.no_grad():
        return detector.decode(detector.eval()(seen), 10)


@pytest.mark.parametrize("kind", KINDS)
def test_it_computes_what_the_exported_network_computes(kind: str, tmp_path: Path) -> None:
    source = lively_detector(KINDS[kind], seed=1)
    file, detector = written(tmp_path / "network.onnx", source), build(KINDS[kind], seed=2)
    fresh = take_exported(file, detector, images(3))
    assert exported_size(file) == (KINDS[kind].size, kind == "depthwise")
    assert detector.training
    if kind == "hybrid":
        assert fresh and all(".narrow." in name or ".attention." in name for name in fresh)
        source.neck.load_state_dict(detector.neck.state_dict())
    else:
        assert not fresh
    # Other pictures than those of the statistics.
    for mine, true in zip(answer(detector, images(4)), answer(source, images(4)), strict=True):
        assert (mine.float() - true.float()).abs().max() < 2e-3 * true.float().abs().max()
    before = detector.backbone.stem.conv.weight.detach().clone()
    for name, parameter in detector.named_parameters():
        assert parameter.requires_grad, name
    detector.train()(images(5)).boxes.sum().backward()
    assert torch.equal(before, detector.backbone.stem.conv.weight)
    assert detector.backbone.stem.conv.weight.grad is not None


def test_halves_will_do(nano: NetworkFile, tmp_path: Path) -> None:
    metadata = NetworkMetadata(tuple(toy_catalogue().objects.values()), WIDTH, HEIGHT, "CC0-1.0", precision="fp16")
    write_onnx(halved(DeployDetector(lively_detector(KINDS["nano"], seed=1), 10)), metadata, tmp_path / "half.onnx")
    whole, half = build(KINDS["nano"]), build(KINDS["nano"])
    take_exported(nano, whole, images(3))
    assert not take_exported(NetworkFile.read(tmp_path / "half.onnx"), half, images(3))
    theirs = half.state_dict()
    for name, weight in whole.named_parameters():
        assert theirs[name].dtype == torch.float32
        assert (theirs[name] - weight).abs().max() <= 5e-3 * weight.abs().max().clamp(min=1e-3), name


def test_layers_of_other_classes_begin_anew(nano: NetworkFile) -> None:
    fresh = take_exported(nano, build(replace(KINDS["nano"], num_classes=CLASSES + 1)), images(3))
    assert fresh == [f"head.levels.{level}.classes.2.{part}" for level in (0, 1) for part in ("weight", "bias")]


def test_another_size_is_refused_and_nothing_is_taken(nano: NetworkFile) -> None:
    detector = build(ModelConfig(CLASSES, "s"))
    before = {name: tensor.clone() for name, tensor in detector.state_dict().items()}
    with pytest.raises(ModelError, match=r"network\.onnx holds a nano network; only \d+% .*leave `initial` out"):
        take_exported(nano, detector, images(3))
    assert all(torch.equal(before[name], tensor) for name, tensor in detector.state_dict().items())


def test_smaller_and_damaged_files_are_refused(nano: NetworkFile, tmp_path: Path) -> None:
    path, model = tmp_path / "network.onnx", onnx.load(nano.path)
    onnx.helper.set_model_props(model, {METADATA_KEY: replace(nano.metadata, precision="int8").to_json()})
    onnx.save(model, path)
    with pytest.raises(ModelError, match=r"holds numbers of 8 bits; .*--precision fp32"):
        take_exported(NetworkFile.read(path), build(KINDS["nano"]), images(3))
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(DataError, match=r"network\.onnx is no ONNX file"):
        NetworkFile.read(path)


def test_a_training_begins_with_it_and_a_new_configuration_takes_its_size(config: TrainConfig, tmp_path: Path) -> None:
    path = tmp_path / "network.onnx"
    written(path, lively_detector(replace(KINDS["depthwise"], num_classes=1)))
    fit(replace(config, initial=path, network=replace(config.network, depthwise=True)))
    write_toy_dataset(tmp_path, 3)
    main(["new", "--models", str(tmp_path / "models"), "--initial", str(path), "--output", str(tmp_path / "new.yaml")])
    new = load_config(TrainConfig, tmp_path / "new.yaml")
    assert new.initial == path and (new.network.size, new.network.depthwise) == ("nano", True)
