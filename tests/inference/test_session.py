"""Network files: run in one batch, and refused with one sentence when they are not ours."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest

from multicam.dataset.objects import Catalogue
from multicam.errors import ModelError
from multicam.inference.metadata import NetworkMetadata
from multicam.inference.session import METADATA_KEY, Network, SessionConfig
from tests.inference.toy_network import HEIGHT, WIDTH, answer, picture_for, toy_metadata, write_network

TABLE = [
    answer([0, 1], [0.9, 0.1], [[1, 2, 11, 12], [0, 0, 1, 1]]),
    answer([4, 2], [0.8, 0.7], [[5, 5, 25, 25], [30, 5, 50, 25]]),
]


@pytest.fixture
def network_file(tmp_path: Path, catalogue: Catalogue) -> Path:
    return write_network(tmp_path / "toy.onnx", TABLE, toy_metadata(catalogue).to_json())


def sentence(path: Path, config: SessionConfig | None = None) -> str:
    with pytest.raises(ModelError) as caught:
        Network(path, config)
    text = str(caught.value)
    assert "\n" not in text
    assert text.endswith(".")
    return text


def test_images_of_different_sizes_are_answered_in_one_batch(network_file: Path) -> None:
    network = Network(network_file, SessionConfig(threads=1))
    batches: list[tuple[int, ...]] = []
    run = network.run
    network.run = lambda batch: batches.append(batch.shape) or run(batch)  # type: ignore[method-assign]
    found = network.detect([picture_for(1), picture_for(0, 2 * WIDTH, 2 * HEIGHT), picture_for(0, 40, 80)])
    assert batches == [(3, HEIGHT, WIDTH, 3)]
    assert [[d.obj_id for d in image] for image in found] == [[5, 3], [1], [1]]
    np.testing.assert_allclose(found[0][0].box, [5, 5, 25, 25])
    # Twice the size: pixel centres p map to 2 p + 0.5.
    np.testing.assert_allclose(found[1][0].box, [2.5, 4.5, 22.5, 24.5])


def test_no_images_give_no_answers(network_file: Path) -> None:
    assert Network(network_file).detect([]) == []


def test_the_metadata_comes_from_the_file(network_file: Path, catalogue: Catalogue) -> None:
    metadata = Network(network_file).metadata
    assert metadata.catalogue().obj_ids == catalogue.obj_ids
    assert (metadata.width, metadata.height) == (WIDTH, HEIGHT)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    assert "does not exist" in sentence(tmp_path / "nowhere" / "x.onnx")


def test_a_file_that_is_not_onnx_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.onnx"
    path.write_text("hello")
    assert "cannot be opened" in sentence(path)


def test_an_empty_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.onnx"
    path.touch()
    assert str(path) in sentence(path)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.99])
def test_a_truncated_file_is_refused(network_file: Path, share: float) -> None:
    data = network_file.read_bytes()
    network_file.write_bytes(data[: int(share * len(data))])
    assert str(network_file) in sentence(network_file)


def test_an_onnx_file_that_is_not_ours_is_refused(tmp_path: Path) -> None:
    assert "not one of ours" in sentence(write_network(tmp_path / "x.onnx", TABLE, None))


def test_a_file_of_another_version_is_refused(tmp_path: Path, catalogue: Catalogue) -> None:
    text = toy_metadata(catalogue).to_json().replace('"version": 1', '"version": 7')
    assert "format version 7" in sentence(write_network(tmp_path / "x.onnx", TABLE, text))


def test_a_file_whose_metadata_is_damaged_is_refused(tmp_path: Path) -> None:
    assert "not valid JSON" in sentence(write_network(tmp_path / "x.onnx", TABLE, "{"))


def test_a_graph_of_another_input_size_than_its_metadata_is_refused(tmp_path: Path, catalogue: Catalogue) -> None:
    metadata = NetworkMetadata(tuple(catalogue.objects.values()), 128, 96, "CC0-1.0").to_json()
    text = sentence(write_network(tmp_path / "x.onnx", TABLE, metadata))
    assert '"images"' in text
    assert "128" in text


def test_a_graph_with_another_number_of_keypoints_is_refused(tmp_path: Path, catalogue: Catalogue) -> None:
    table = [answer([0], [0.9], [[0, 0, 1, 1]], num_keypoints=9)]
    assert '"keypoints"' in sentence(write_network(tmp_path / "x.onnx", table, toy_metadata(catalogue).to_json()))


def test_a_graph_for_one_size_of_batch_is_refused(network_file: Path) -> None:
    change(network_file, lambda model: set_side(model.graph.input[0], 0, 1))
    assert "batches of 1 alone" in sentence(network_file)


def test_outputs_with_different_numbers_of_rows_are_refused(network_file: Path) -> None:
    change(network_file, lambda model: [set_side(o, 1, 7) for o in model.graph.output if o.name == "std"])
    assert "different numbers of rows" in sentence(network_file)


@pytest.mark.parametrize("version", ["opset", "ir"])
def test_a_file_newer_than_the_runtime_is_not_called_damaged(network_file: Path, version: str) -> None:
    def renew(model: onnx.ModelProto) -> None:
        if version == "ir":
            model.ir_version = 99
        else:
            model.opset_import[0].version = 99

    change(network_file, renew)
    text = sentence(network_file)
    assert "needs a newer ONNX Runtime than" in text
    assert "damaged" not in text


def test_a_file_whose_classes_were_edited_is_refused(network_file: Path, catalogue: Catalogue) -> None:
    content = json.loads(toy_metadata(catalogue).to_json())
    del content["classes"][1]
    change(network_file, lambda model: onnx.helper.set_model_props(model, {METADATA_KEY: json.dumps(content)}))
    assert "classes were changed after export" in sentence(network_file)


def change(path: Path, edit: Callable[[onnx.ModelProto], object]) -> None:
    """Edits a network file in place."""
    model = onnx.load(path)
    edit(model)
    onnx.save(model, path)


def set_side(value: onnx.ValueInfoProto, axis: int, size: int) -> None:
    value.type.tensor_type.shape.dim[axis].dim_value = size


def test_a_misspelt_execution_provider_gets_a_suggestion(network_file: Path) -> None:
    assert 'did you mean "cuda"' in sentence(network_file, SessionConfig(provider="cude"))


def test_an_execution_provider_that_is_not_there_is_never_replaced(network_file: Path) -> None:
    text = sentence(network_file, SessionConfig(provider="coreml"))
    assert "only cpu" in text or "available" in text
