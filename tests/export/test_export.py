"""Export end to end: a checkpoint becomes a file that the runtime reads, agrees with PyTorch, or does not appear."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
import torch
from safetensors.torch import load_file, save_file

from export import cli
from export.cli import export
from export.config import ExportConfig
from export.parity import PROBABILITY_TOLERANCE, Parity, compare
from export.wrapper import DeployDetector
from models.config import ModelConfig
from models.detector import Decoded, Detector
from multicam.cli import USAGE_ERROR, run
from multicam.errors import ConfigError, DataError, ModelError
from multicam.inference.decode import DecodeConfig
from multicam.inference.session import Network
from tests.export.conftest import HEIGHT, ROWS, WIDTH, lively_detector, pictures, write_checkpoint
from tests.toy_objects import toy_catalogue


def test_the_file_says_what_it_is(exported: Path) -> None:
    metadata = Network(exported).metadata
    catalogue = toy_catalogue()
    assert metadata.catalogue().obj_ids == catalogue.obj_ids
    assert (metadata.width, metadata.height, metadata.licence) == (WIDTH, HEIGHT, "Apache-2.0")
    assert metadata.precision == "fp32"
    assert metadata.training["epochs"] == 3
    assert metadata.training["validation"] == {"add_0.1d": 0.25}


def test_the_file_stands_alone_with_its_configuration_beside_it(exported: Path) -> None:
    assert sorted(p.name for p in exported.parent.iterdir()) == ["toy.onnx", "toy.yaml"]
    onnx.checker.check_model(onnx.load(exported), full_check=True)


def test_the_file_does_not_tell_where_it_was_made(exported: Path) -> None:
    data = exported.read_bytes()
    assert str(Path(cli.__file__).parents[1]).encode() not in data
    assert b"site-packages" not in data


def test_the_runtime_detects_with_it_in_images_of_any_size(exported: Path, rng: np.random.Generator) -> None:
    images = [rng.integers(0, 256, size, dtype=np.uint8) for size in ((64, 96, 3), (200, 100, 3), (48, 300, 3))]
    found = Network(exported).detect(images, DecodeConfig(score_threshold=0.0, nms_iou=1.0))
    assert [len(image) for image in found] == [ROWS] * 3
    for detection in found[1]:
        assert detection.keypoints.shape == detection.std.shape == (8, 2)
        assert np.isfinite(detection.keypoints).all()
        assert (detection.std > 0).all()


@pytest.mark.parametrize("batch", [1, 3, 8, 32])
def test_onnx_runtime_agrees_with_the_unfused_network(
    exported: Path, detector: Detector, rng: np.random.Generator, batch: int
) -> None:
    images = pictures(rng, batch)
    with torch.inference_mode():
        raw = detector(torch.from_numpy(images).permute(0, 3, 1, 2).float())
        best = raw.class_logits.amax(dim=2).topk(ROWS + 1, dim=1).values.sigmoid().numpy()
        expected = detector.decode(raw, ROWS)
    answers = Decoded(*Network(exported).run(images))
    # Rows whose scores differ from their neighbours' by rounding alone may change places.
    gaps = np.pad(best[:, :-1] - best[:, 1:], ((0, 0), (1, 0)), constant_values=1)
    clear = np.minimum(gaps[:, 1:], gaps[:, :-1]) > 1e-5
    assert clear.mean() > 0.8
    for name, tolerance in {"boxes": 1e-3, "scores": 1e-5, "labels": 0, "keypoints": 1e-3, "std": 1e-3}.items():
        found, wanted = getattr(answers, name)[clear], getattr(expected, name).numpy()[clear]
        np.testing.assert_allclose(found, wanted, rtol=0, atol=tolerance, err_msg=name)
    np.testing.assert_allclose(answers.visibility[clear], expected.visibility.numpy()[clear], atol=1e-5)
    assert np.all(np.diff(answers.scores, axis=1) <= 0)
    # The test would be empty if every picture were answered alike.
    assert answers.keypoints[:, 0].std(axis=0).max() > 1 or batch == 1


def test_another_network_is_told_apart(exported: Path, model_config: ModelConfig) -> None:
    other = DeployDetector(lively_detector(model_config, seed=1), ROWS)
    parity = compare(other, Network(exported), [])
    assert parity.keypoints > 1
    with pytest.raises(ModelError, match="differ in"):
        parity.require(1e-3)


def test_cells_that_tie_may_change_places(exported: Path, detector: Detector) -> None:
    network, deployed = Network(exported), DeployDetector(detector, ROWS)
    run = network.run

    def with_two_rows_swapped(batch: np.ndarray) -> list[np.ndarray]:
        outputs = run(batch)
        outputs[1][:, 3] = outputs[1][:, 2]
        return [np.ascontiguousarray(o[:, [0, 1, 3, 2, *range(4, ROWS)]]) for o in outputs]

    network.run = with_two_rows_swapped
    parity = compare(deployed, network, [])
    assert max(parity.boxes, parity.keypoints, parity.std, parity.visibility, parity.labels) < 1e-3


def test_a_cell_answered_twice_is_found(exported: Path, detector: Detector) -> None:
    network, run = Network(exported), Network(exported).run
    network.run = lambda batch: [np.ascontiguousarray(o[:, [0, 0, *range(2, ROWS)]]) for o in run(batch)]
    assert compare(DeployDetector(detector, ROWS), network, []).choice > PROBABILITY_TOLERANCE


def test_what_is_not_a_number_never_passes() -> None:
    with pytest.raises(ModelError, match="keypoints by nan"):
        Parity(0, 0, 0, 0, float("nan"), 0, 0).require(1e-3)


@pytest.mark.usefixtures("quick_export")
def test_no_file_is_left_when_parity_fails(checkpoint: Path, tmp_path: Path) -> None:
    config = ExportConfig(checkpoint, tmp_path / "x.onnx", rows=ROWS, tolerance_px=1e-12)
    with pytest.raises(ModelError, match="no file was written"):
        export(config)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("quick_export")
def test_an_older_file_survives_when_parity_fails(checkpoint: Path, tmp_path: Path) -> None:
    path = tmp_path / "x.onnx"
    path.write_text("older")
    with pytest.raises(ModelError):
        export(ExportConfig(checkpoint, path, rows=ROWS, tolerance_px=1e-12))
    assert path.read_text() == "older"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.usefixtures("quick_export")
def test_given_pictures_are_compared_too(
    checkpoint: Path, tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "pictures" / "inner"
    folder.mkdir(parents=True)
    for i in range(30):
        cv2.imwrite(str(folder / f"{i}.jpg"), rng.integers(0, 256, (50, 70, 3), dtype=np.uint8))
    given: list[int] = []
    monkeypatch.setattr(cli, "compare", recording(compare, given))
    export(ExportConfig(checkpoint, tmp_path / "x.onnx", rows=ROWS, images=tmp_path / "pictures"))
    assert given == [12]


def recording(function: Callable[..., Parity], counts: list[int]) -> Callable[..., Parity]:
    def wrapped(detector: DeployDetector, network: Network, images: list[np.ndarray]) -> Parity:
        counts.append(len(images))
        return function(detector, network, images)

    return wrapped


def test_batches_of_all_sizes_are_compared(exported: Path, detector: Detector) -> None:
    network, sizes = Network(exported), set()
    run = network.run
    network.run = lambda batch: sizes.add(len(batch)) or run(batch)
    compare(DeployDetector(detector, ROWS), network, [])
    assert sizes == {1, 3, 8, 32}


def test_a_difference_in_the_last_picture_of_a_batch_is_found(exported: Path, detector: Detector) -> None:
    network, run = Network(exported), Network(exported).run

    def with_a_moved_keypoint(batch: np.ndarray) -> list[np.ndarray]:
        outputs = run(batch)
        outputs[3][31:, 0, 0, 0] += 0.1
        return outputs

    network.run = with_a_moved_keypoint
    assert compare(DeployDetector(detector, ROWS), network, []).keypoints > 1e-3


def test_a_folder_without_pictures_is_refused(checkpoint: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no pictures"):
        export(ExportConfig(checkpoint, tmp_path / "x.onnx", images=tmp_path))


def test_a_missing_checkpoint_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="checkpoint folder"):
        export(ExportConfig(tmp_path / "best", tmp_path / "x.onnx"))


def test_weights_of_another_network_are_refused(detector: Detector, model_config: ModelConfig, tmp_path: Path) -> None:
    folder = write_checkpoint(tmp_path / "best", detector, model_config, toy_catalogue())
    weights = load_file(folder / "ema.safetensors")
    weights.popitem()
    save_file(weights, folder / "ema.safetensors")
    with pytest.raises(ModelError, match=r"do not fit its model\.json") as caught:
        export(ExportConfig(folder, tmp_path / "x.onnx"))
    assert "\n" not in str(caught.value)


def test_unfit_options_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"\.onnx"):
        ExportConfig(output=Path("network.pt"))
    with pytest.raises(ConfigError, match="rows"):
        ExportConfig(rows=0)
    with pytest.raises(ConfigError, match="tolerance_px"):
        ExportConfig(tolerance_px=float("nan"))


def test_the_command_line_ends_a_mistake_with_one_sentence_and_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["export", "--checkpoint", str(tmp_path / "none"), "--output", str(tmp_path / "x.onnx")]
    assert run(command) == USAGE_ERROR
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "checkpoint folder" in message
    assert list(tmp_path.iterdir()) == []
