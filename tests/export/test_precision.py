"""fp16 and int8 files: opened by the runtime unchanged, near the single-precision file, with nothing of it dropped."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto

from export.cli import export
from export.config import ExportConfig, LossLimits
from export.half import halved
from export.int8 import KEPT_SINGLE, write_int8
from export.to_onnx import write_onnx
from export.wrapper import DeployDetector
from models.detector import Detector
from multicam.errors import ConfigError, DataError, ModelError
from multicam.inference.decode import DecodeConfig
from multicam.inference.session import METADATA_KEY, Network
from multicam.progress import SilentProgress
from tests.export.conftest import ROWS, pictures


@pytest.fixture(scope="module")
def half_file(exported: Path, detector: Detector, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("half") / "toy.onnx"
    metadata = replace(Network(exported).metadata, precision="fp16")
    write_onnx(halved(DeployDetector(detector, ROWS)), metadata, path)
    return path


@pytest.fixture(scope="module")
def int8_file(exported: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("int8") / "toy.onnx"
    metadata = replace(Network(exported).metadata, precision="int8")
    write_int8(exported, metadata, list(pictures(np.random.default_rng(5), 16)), path, SilentProgress())
    return path


@pytest.fixture(params=["fp16", "int8"])
def smaller(request: pytest.FixtureRequest) -> tuple[str, Path]:
    return request.param, request.getfixturevalue("half_file" if request.param == "fp16" else "int8_file")


def split(folder: Path, rng: np.random.Generator, count: int) -> Path:
    """A BOP split of pictures without objects."""
    scene = folder / "000000"
    (scene / "rgb").mkdir(parents=True)
    for i, picture in enumerate(pictures(rng, count)):
        cv2.imwrite(str(scene / "rgb" / f"{i:06d}.png"), picture)
    (scene / "scene_camera.json").write_text(json.dumps({str(i): {} for i in range(count)}))
    return folder


def test_the_metadata_is_that_of_the_checkpoint_and_says_the_precision(
    exported: Path, smaller: tuple[str, Path]
) -> None:
    precision, path = smaller
    metadata = Network(path).metadata
    assert metadata.precision == precision
    assert replace(metadata, precision="fp32").to_json() == Network(exported).metadata.to_json()


def test_nothing_is_left_of_the_tools_that_made_the_file(smaller: tuple[str, Path]) -> None:
    model = onnx.load(smaller[1])
    assert [entry.key for entry in model.metadata_props] == [METADATA_KEY]
    assert model.producer_name == "multicam-pose"
    assert b"site-packages" not in smaller[1].read_bytes()
    assert [path.name for path in smaller[1].parent.iterdir()] == ["toy.onnx"]


def test_the_file_is_smaller(exported: Path, smaller: tuple[str, Path]) -> None:
    assert smaller[1].stat().st_size < 0.65 * exported.stat().st_size


@pytest.mark.parametrize("batch", [1, 3, 8])
def test_every_batch_is_answered_much_as_in_single_precision(
    exported: Path, smaller: tuple[str, Path], rng: np.random.Generator, batch: int
) -> None:
    images = list(pictures(rng, batch))
    config = DecodeConfig(score_threshold=0.0, nms_iou=1.0)
    wanted, found = (Network(path).detect(images, config) for path in (exported, smaller[1]))
    for one, other in zip(wanted, found, strict=True):
        assert [len(one), len(other)] == [ROWS, ROWS]
        # The best cell of a lively network stands out, and stays the best.
        near = min(np.abs(one[0].keypoints - d.keypoints).max() for d in other[:5])
        assert near < (0.3 if smaller[0] == "fp16" else 15)
        assert abs(one[0].score - other[0].score) < (0.01 if smaller[0] == "fp16" else 0.15)


def test_the_answers_for_a_picture_do_not_depend_on_its_batch(
    smaller: tuple[str, Path], rng: np.random.Generator
) -> None:
    images, network = pictures(rng, 3), Network(smaller[1])
    together = network.run(images)
    for i in range(3):
        for whole, alone in zip(together, network.run(images[i : i + 1]), strict=True):
            np.testing.assert_allclose(whole[i], alone[0], atol=2e-2)


def test_half_precision_spares_the_last_layers_and_the_decoding(half_file: Path) -> None:
    types = {tensor.name: tensor.data_type for tensor in onnx.load(half_file).graph.initializer}
    single = {name for name, kind in types.items() if kind == TensorProto.FLOAT and name.endswith("weight")}
    half = {name for name, kind in types.items() if kind == TensorProto.FLOAT16 and name.endswith("weight")}
    assert any("backbone" in name for name in half)
    assert any("neck" in name for name in half)
    assert any("pose" in name for name in half)
    assert len(half) > 5 * len(single)
    assert all("classifier" in name or "outputs" in name or "classes.2" in name for name in single)


def test_8_bits_are_for_the_convolutions_that_bear_them(exported: Path, int8_file: Path) -> None:
    convolutions = [n for n in onnx.load(exported).graph.node if n.op_type == "Conv"]
    # A part that is named in vain would mean that a layer was renamed, and is computed in 8 bits unnoticed.
    for part in KEPT_SINGLE:
        assert any(part in name for node in convolutions for name in node.input), part
    graph = onnx.load(int8_file).graph
    makers = {output: node for node in graph.node for output in node.output}
    eight = [n for n in graph.node if n.op_type == "Conv" and makers.get(n.input[1], n).op_type == "DequantizeLinear"]
    kept = [n for n in convolutions if any(part in name for name in n.input for part in KEPT_SINGLE)]
    assert len(eight) == len(convolutions) - len(kept)
    assert len(eight) > len(convolutions) / 2
    scales = {t.name: t for t in graph.initializer}
    for node in eight:
        assert len(scales[makers[node.input[1]].input[1]].dims) == 1, "a scale per channel"


@pytest.mark.usefixtures("quick_export")
def test_the_command_tells_what_int8_loses(checkpoint: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    images, calibration = split(tmp_path / "images", rng, 4), split(tmp_path / "calibration", rng, 6)
    config = ExportConfig(
        checkpoint, tmp_path / "x.onnx", "int8", ROWS, images=images, calibration=calibration,
        loss=LossLimits(least_same=0.01, most_keypoint_px=1e3),
    )  # fmt: skip
    loss = export(config).loss
    assert loss is not None
    assert (loss.pictures, loss.truth) == (4, None)
    assert 0.3 < loss.same < 1
    assert 0 < loss.keypoint_px.median < loss.keypoint_px.most
    assert Network(config.output).metadata.precision == "int8"


@pytest.mark.usefixtures("quick_export")
def test_a_file_that_loses_too_much_is_not_written(checkpoint: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    images, calibration = split(tmp_path / "images", rng, 2), split(tmp_path / "calibration", rng, 2)
    path = tmp_path / "written" / "x.onnx"
    config = ExportConfig(
        checkpoint, path, "int8", ROWS, images=images, calibration=calibration,
        loss=LossLimits(least_same=0.01, most_keypoint_px=1e-6),
    )  # fmt: skip
    with pytest.raises(
        ModelError, match=r"keypoints move by .* px .*, and loss\.most_keypoint_px is 1e-06; no file was"
    ):
        export(config)
    assert list(path.parent.iterdir()) == []


def test_a_calibration_folder_that_is_no_split_is_refused(
    checkpoint: Path, tmp_path: Path, rng: np.random.Generator, quick_export: None
) -> None:
    (tmp_path / "empty").mkdir()
    images = split(tmp_path / "images", rng, 1)
    config = ExportConfig(checkpoint, tmp_path / "x.onnx", "int8", ROWS, images=images, calibration=tmp_path / "empty")
    with pytest.raises(DataError, match="no scene folders"):
        export(config)


def test_what_a_precision_needs_is_asked_for() -> None:
    with pytest.raises(ConfigError, match="--images"):
        ExportConfig(precision="fp16")
    with pytest.raises(ConfigError, match="--calibration"):
        ExportConfig(precision="int8", images=Path("x"))
    with pytest.raises(ConfigError, match="leave --calibration out"):
        ExportConfig(precision="fp16", images=Path("x"), calibration=Path("x"))
    with pytest.raises(ConfigError, match="least_same"):
        LossLimits(least_same=1.5)
