"""A network file of our format that answers from a table: the red value at the middle of an image picks the row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from multicam.dataset.objects import Catalogue
from multicam.inference.metadata import NetworkMetadata
from multicam.inference.session import INPUT_NAME, METADATA_KEY, OUTPUT_NAMES

WIDTH, HEIGHT = 64, 48
Answer = Mapping[str, np.ndarray]


def toy_metadata(catalogue: Catalogue) -> NetworkMetadata:
    return NetworkMetadata(tuple(catalogue.objects.values()), WIDTH, HEIGHT, "CC0-1.0")


def answer(
    labels: Sequence[int],
    scores: Sequence[float],
    boxes: Sequence[Sequence[float]],
    keypoints: np.ndarray | None = None,
    std: float = 1.0,
    num_keypoints: int = 8,
) -> Answer:
    """One row of the table; keypoints (N, K, 2), zeros if None."""
    n = len(labels)
    return {
        "boxes": np.array(boxes, dtype=np.float32).reshape(n, 4),
        "scores": np.array(scores, dtype=np.float32),
        "labels": np.array(labels, dtype=np.int64),
        "keypoints": np.zeros((n, num_keypoints, 2), np.float32) if keypoints is None else keypoints.astype(np.float32),
        "visibility": np.full((n, num_keypoints), 0.9, dtype=np.float32),
        "std": np.full((n, num_keypoints, 2), std, dtype=np.float32),
    }


def picture_for(row: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """(height, width, 3) uint8, an image that picks the given row of the table."""
    return np.full((height, width, 3), row, dtype=np.uint8)


def write_network(
    path: Path, table: Sequence[Answer], metadata: str | None, width: int = WIDTH, height: int = HEIGHT
) -> Path:
    """Writes the file; all answers of the table need equally many rows N."""
    initializers = [
        numpy_helper.from_array(np.array(value, dtype=np.int64), name)
        for name, value in (("start", [height // 2, width // 2, 0]), ("end", [height // 2 + 1, width // 2 + 1, 1]))
    ]
    initializers += [
        numpy_helper.from_array(np.array([1, 2, 3], dtype=np.int64), "axes"),
        numpy_helper.from_array(np.array([-1], dtype=np.int64), "flat"),
    ]
    nodes = [
        helper.make_node("Slice", [INPUT_NAME, "start", "end", "axes"], ["pixel"]),
        helper.make_node("Reshape", ["pixel", "flat"], ["value"]),
        helper.make_node("Cast", ["value"], ["row"], to=TensorProto.INT64),
    ]
    outputs = []
    for name in OUTPUT_NAMES:
        values = np.stack([row[name] for row in table])
        initializers.append(numpy_helper.from_array(values, f"{name}_table"))
        nodes.append(helper.make_node("Gather", [f"{name}_table", "row"], [name], axis=0))
        kind = helper.np_dtype_to_tensor_dtype(values.dtype)
        outputs.append(helper.make_tensor_value_info(name, kind, ["batch", *values.shape[1:]]))
    image = helper.make_tensor_value_info(INPUT_NAME, TensorProto.UINT8, ["batch", height, width, 3])
    graph = helper.make_graph(nodes, "toy", [image], outputs, initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    if metadata is not None:
        helper.set_model_props(model, {METADATA_KEY: metadata})
    onnx.save(model, path)
    return path
