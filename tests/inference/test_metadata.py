"""The metadata of a network file: written and read back, refused when it is not ours."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from multicam.dataset.objects import Catalogue
from multicam.errors import ModelError
from multicam.inference.metadata import NetworkMetadata, objects_from_json, objects_to_json


@pytest.fixture
def metadata(catalogue: Catalogue) -> NetworkMetadata:
    return NetworkMetadata(tuple(catalogue.objects.values()), 320, 256, "CC0-1.0", {"epochs": 3})


def test_classes_survive_json_to_the_last_bit(catalogue: Catalogue) -> None:
    back = objects_from_json(json.loads(json.dumps(objects_to_json(catalogue))), "objects.json")
    assert back.obj_ids == catalogue.obj_ids
    for obj_id, model in catalogue.objects.items():
        read = back[obj_id]
        assert (read.name, read.diameter, read.mesh_path) == (model.name, model.diameter, None)
        np.testing.assert_array_equal(read.keypoints, model.keypoints)
        np.testing.assert_array_equal(read.box, model.box)
        np.testing.assert_array_equal(read.symmetries.discrete, model.symmetries.discrete)
        for one, other in zip(read.symmetries.axes, model.symmetries.axes, strict=True):
            np.testing.assert_allclose(one.direction, other.direction, atol=1e-15)
            np.testing.assert_array_equal(one.offset, other.offset)


def test_metadata_survives_json(metadata: NetworkMetadata) -> None:
    back = NetworkMetadata.from_json(metadata.to_json(), "x.onnx")
    assert back.to_json() == metadata.to_json()
    assert (back.width, back.height, back.licence, back.training) == (320, 256, "CC0-1.0", {"epochs": 3})
    assert back.num_keypoints == 8


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"format": "other"}, "does not say"),
        ({"version": 99}, "format version 99"),
        ({"classes": [{"obj_id": 1}]}, "class 0"),
        ({"classes": []}, "at least one object class"),
        ({"licence": None, "input": {}}, "width"),
        ({"input": {"width": 320, "height": 256, "layout": "NCHW"}}, "NCHW"),
        ({"precision": "fp4"}, "computes with fp4 numbers"),
        ({"outputs": {"classes": 2, "keypoints": 8}}, "classes were changed after export"),
        ({"outputs": {"classes": 3, "keypoints": 9}}, "classes were changed after export"),
    ],
)
def test_unfit_metadata_is_refused_with_the_reason(
    metadata: NetworkMetadata, change: dict[str, object], sentence: str
) -> None:
    text = json.dumps({**json.loads(metadata.to_json()), **change})
    with pytest.raises(ModelError, match=sentence) as caught:
        NetworkMetadata.from_json(text, "x.onnx")
    assert "\n" not in str(caught.value)


def test_files_of_the_first_programs_are_single_precision(metadata: NetworkMetadata) -> None:
    content = json.loads(replace(metadata, precision="int8").to_json())
    assert NetworkMetadata.from_json(json.dumps(content), "x.onnx").precision == "int8"
    del content["precision"], content["outputs"]
    assert NetworkMetadata.from_json(json.dumps(content), "x.onnx").precision == "fp32"


def test_an_id_that_comes_twice_is_refused(catalogue: Catalogue) -> None:
    rows = objects_to_json(catalogue)
    with pytest.raises(ModelError, match="two classes have the id"):
        objects_from_json([*rows, rows[-1]], "objects.json")


def test_text_that_is_not_json_is_refused() -> None:
    with pytest.raises(ModelError, match="not valid JSON"):
        NetworkMetadata.from_json("{", "x.onnx")


def test_keypoints_of_another_shape_are_refused(catalogue: Catalogue) -> None:
    rows = objects_to_json(catalogue)
    rows[1]["keypoints"] = [[1, 2], [3, 4]]
    with pytest.raises(ModelError, match="class 1"):
        objects_from_json(rows, "objects.json")


def test_classes_with_different_keypoint_counts_are_refused(catalogue: Catalogue) -> None:
    rows = objects_to_json(catalogue)
    rows[0]["keypoints"] = rows[0]["keypoints"][:5]
    mixed = objects_from_json(rows, "objects.json")
    with pytest.raises(ModelError, match="equally many keypoints"):
        NetworkMetadata(tuple(mixed.objects.values()), 320, 320, "CC0-1.0")
