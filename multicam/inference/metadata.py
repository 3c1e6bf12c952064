"""What a network file says of itself: its classes in metres, its input, its licence. Format: docs/export.md."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any, Literal, cast, get_args

import numpy as np

from multicam.dataset.objects import Catalogue, ObjectModel
from multicam.errors import ModelError
from multicam.geometry.symmetry import Axis, Symmetries
from multicam.image import PADDING
from multicam.types import FloatArray

FORMAT = "multicam-network"
VERSION = 1
PREPROCESSING = {"layout": "NHWC", "type": "uint8", "colour": "RGB", "letterbox_padding": PADDING}
"""What every network of this format takes; normalisation is inside the graph."""

Precision = Literal["fp32", "fp16", "int8"]
"""Numbers that a network computes with: single, half, or 8-bit integers; the decoding is always single."""


@dataclass(frozen=True, eq=False)
class NetworkMetadata:
    """The part of a network file that is not numbers.

    Attributes:
        objects: one per class; the network's label i means objects[i]. All have equally many keypoints.
        width, height: input size, pixels.
        licence: of the weights.
        training: plain summary of how the weights came about (epochs, figures), for people to read.
        precision: numbers that the network computes with.
    """

    objects: tuple[ObjectModel, ...]
    width: int
    height: int
    licence: str
    training: dict[str, Any] = field(default_factory=dict[str, Any])
    precision: Precision = "fp32"

    def __post_init__(self) -> None:
        if not self.objects:
            raise ModelError("a network needs at least one object class; its metadata names none.")
        obj_ids = [o.obj_id for o in self.objects]
        if obj_ids != sorted(set(obj_ids)):
            raise ModelError(f"the classes of a network must have ascending ids; its metadata has {obj_ids}.")
        counts = {o.name: 0 if o.keypoints is None else len(o.keypoints) for o in self.objects}
        if len(set(counts.values())) != 1 or 0 in counts.values():
            raise ModelError(f"all classes of a network need equally many keypoints; they have {counts}.")

    @property
    def num_keypoints(self) -> int:
        """Keypoints of each object."""
        points = self.objects[0].keypoints
        assert points is not None, "checked when made"
        return len(points)

    @property
    def outputs(self) -> dict[str, int]:
        """Classes and keypoints that the network can answer with."""
        return {"classes": len(self.objects), "keypoints": self.num_keypoints}

    def catalogue(self) -> Catalogue:
        """The classes as a catalogue, without meshes."""
        return Catalogue({o.obj_id: o for o in self.objects})

    def to_json(self) -> str:
        """The JSON text that `from_json` reads."""
        content = {
            "format": FORMAT,
            "version": VERSION,
            "input": {"width": self.width, "height": self.height, **PREPROCESSING},
            "precision": self.precision,
            "outputs": self.outputs,
            "licence": self.licence,
            "classes": objects_to_json(self.catalogue()),
            "training": self.training,
        }
        return json.dumps(content, allow_nan=False)

    @classmethod
    def from_json(cls, text: str, source: str) -> NetworkMetadata:
        """Reads metadata; `source` names the file in errors.

        Raises:
            ModelError: not JSON, not this format, another version, fields missing or unfit, or other classes than the
                network was exported with.
        """
        try:
            content: Any = json.loads(text)
        except json.JSONDecodeError as error:
            raise ModelError(f"the multicam metadata of {source} is not valid JSON: {error.msg}.") from error
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise ModelError(f'the multicam metadata of {source} does not say "format": "{FORMAT}".')
        if content.get("version") != VERSION:
            raise ModelError(
                f"{source} has format version {content.get('version')} and this program reads version {VERSION}; "
                "export the checkpoint again."
            )
        try:
            size = dict(content["input"])
            width, height = int(size.pop("width")), int(size.pop("height"))
            objects = tuple(objects_from_json(content["classes"], source).objects.values())
            licence, training = str(content["licence"]), dict(content["training"])
            # Files of the first programs say neither; all of them were fp32.
            precision, outputs = content.get("precision", "fp32"), content.get("outputs")
        except (KeyError, ValueError, TypeError) as error:
            raise ModelError(f"the multicam metadata of {source} is incomplete: {error!r}.") from error
        if size != PREPROCESSING:
            raise ModelError(f"{source} wants its input as {size}; this program gives {PREPROCESSING}.")
        if precision not in get_args(Precision):
            raise ModelError(
                f"{source} computes with {precision} numbers; this program knows {', '.join(get_args(Precision))}."
            )
        metadata = cls(objects, width, height, licence, training, cast(Precision, precision))
        if outputs not in (None, metadata.outputs):
            raise ModelError(
                f"the network in {source} answers with {outputs}, but its metadata describes {metadata.outputs}; its "
                "classes were changed after export."
            )
        return metadata


def objects_to_json(catalogue: Catalogue) -> list[dict[str, Any]]:
    """The classes as plain data in metres, in the order of the labels; mesh files are left out."""
    return [
        {
            "obj_id": model.obj_id,
            "name": model.name,
            "diameter": model.diameter,
            "box": None if model.box is None else model.box.tolist(),
            "keypoints": None if model.keypoints is None else model.keypoints.tolist(),
            "symmetries": {
                "discrete": model.symmetries.discrete.tolist(),
                "axes": [
                    {"direction": axis.direction.tolist(), "offset": axis.offset.tolist()}
                    for axis in model.symmetries.axes
                ],
            },
        }
        for model in catalogue.objects.values()
    ]


def objects_from_json(rows: Any, source: str) -> Catalogue:
    """Inverse of `objects_to_json`; `source` names the file in errors.

    Raises:
        ModelError: a row lacks a field, a field has another shape, or an id comes twice.
    """
    objects: dict[int, ObjectModel] = {}
    for index, row in enumerate(rows):
        try:
            model = _read_object(row)
        except (KeyError, ValueError, TypeError) as error:
            raise ModelError(f"{source}: class {index} is not as this program writes it: {error!r}.") from error
        if model.obj_id in objects:
            raise ModelError(f"{source}: two classes have the id {model.obj_id}.")
        objects[model.obj_id] = model
    return Catalogue(objects)


def _read_object(row: dict[str, Any]) -> ObjectModel:
    axes = tuple(Axis(_array(a["direction"], 3), _array(a["offset"], 3)) for a in row["symmetries"]["axes"])
    symmetries = Symmetries(np.array(row["symmetries"]["discrete"], dtype=np.float64).reshape(-1, 4, 4), axes)
    box = None if row["box"] is None else _array(row["box"], 2, 3)
    keypoints = None if row["keypoints"] is None else _array(row["keypoints"], -1, 3)
    return ObjectModel(int(row["obj_id"]), str(row["name"]), float(row["diameter"]), symmetries, box, keypoints)


def _array(value: Any, *shape: int) -> FloatArray:
    array = np.array(value, dtype=np.float64)
    if array.ndim != len(shape) or any(want not in (-1, got) for want, got in zip(shape, array.shape, strict=True)):
        raise ValueError(f"expected an array of shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError("expected finite numbers")
    return array
