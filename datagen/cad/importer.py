"""A folder of CAD files and its parts.yaml to a BOP models folder."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from datagen.cad.clean import cleaned, is_watertight
from datagen.cad.parts import PartConfig, PartsConfig, digest, read_parts
from datagen.cad.symmetry import measure, propose
from datagen.cad.turns import generators, in_words
from datagen.cad.units import METRES, Unit, require_plausible
from multicam.dataset.bop_writer import write_models
from multicam.dataset.objects import MILLIMETRE, Catalogue, ObjectModel
from multicam.errors import DataError
from multicam.evaluation.report import Column, Table
from multicam.files import read_json, require_file, write_json
from multicam.geometry.keypoints import sample_keypoints
from multicam.geometry.mesh import Mesh, load_mesh
from multicam.geometry.symmetry import Symmetries
from multicam.progress import Progress
from multicam.types import FloatArray

RECORD = "import.json"
"""Stands beside the models: where they came from, and what was found."""


@dataclass(frozen=True)
class ImportedPart:
    """What is known of an imported part.

    Attributes:
        triangles: faces after cleaning.
        symmetry: in words.
        proposed: whether the symmetries were proposed, not stated.
        deviation_mm: by which 95 % of the surface miss themselves at most under the symmetries.
        statement: the symmetries as one would write them in parts.yaml.
    """

    obj_id: int
    name: str
    file: str
    unit: str
    size_mm: tuple[float, float, float]
    diameter_mm: float
    triangles: int
    watertight: bool
    symmetry: str
    proposed: bool
    deviation_mm: float
    statement: str

    @property
    def deviation_percent(self) -> float:
        """The deviation in percent of the diameter."""
        return 100 * self.deviation_mm / self.diameter_mm


def import_parts(
    parts: Path, output: Path, keypoints: int, seed: int, progress: Progress, replace: bool = False
) -> tuple[ImportedPart, ...]:
    """Writes the parts as a BOP models folder, unless they are there already.

    Args:
        parts: the YAML file.
        output: receives meshes (PLY, mm) with their pictures, models_info.json, keypoints.json, import.json and, if
            parts.yaml names them, assemblies.json.
        keypoints: how many of each object, by farthest point sampling.
        replace: overwrite what was imported from other parts.

    Raises:
        ConfigError: parts.yaml does not fit.
        DataError: a mesh is missing, unreadable or of an implausible size, or other models are there.
    """
    config = read_parts(parts)
    source = {"digest": digest(parts, config), "keypoints": keypoints, "seed": seed}
    if (output / "models_info.json").is_file() and not replace:
        found = read_record(output)
        if found is None or read_json(output / RECORD)["source"] != source:
            raise DataError(
                f"{output} holds other models than {parts} now describes, and pictures and networks may depend on "
                "them; give another output, delete the folder, or `multicam datagen import --parts "
                f"{parts} --output {output} --replace`."
            )
        return found
    with tempfile.TemporaryDirectory(prefix="datagen-") as pictures:
        meshes = _load(config, parts, Path(pictures))
        models: dict[int, ObjectModel] = {}
        rows: list[ImportedPart] = []
        named = zip(config.parts, meshes, strict=True)
        for part, mesh in progress.track(named, "looking for symmetries", len(meshes)):
            assert part.obj_id is not None
            symmetries = part.stated(config.unit)
            found = propose(mesh) if symmetries is None else measure(mesh, symmetries)
            points = sample_keypoints(mesh, keypoints, np.random.default_rng((seed, part.obj_id)))
            models[part.obj_id] = ObjectModel(
                part.obj_id, part.name, mesh.diameter(), found.symmetries, mesh.box, points
            )
            rows.append(_row(part, config.unit, mesh, found.symmetries, found.deviation))
        (output / "models_info.json").unlink(missing_ok=True)
        _copy_assemblies(config, parts, output)
        write_json(output / RECORD, {"source": source, "parts": [asdict(row) for row in rows]}, indent=1)
        shapes = {row.obj_id: mesh for row, mesh in zip(rows, meshes, strict=True)}
        write_models(output, Catalogue(dict(sorted(models.items()))), dict(sorted(shapes.items())))
    return tuple(rows)


def read_record(models: Path) -> tuple[ImportedPart, ...] | None:
    """What import.json of a models folder says of its parts, or None for models that were not imported."""
    path = models / RECORD
    if not path.is_file():
        return None
    try:
        return tuple(ImportedPart(**(row | {"size_mm": tuple(row["size_mm"])})) for row in read_json(path)["parts"])
    except (KeyError, TypeError) as error:
        raise DataError(
            f"{path} is not what `multicam datagen import` wrote; delete {models} and import again."
        ) from error


def parts_table(rows: Sequence[ImportedPart]) -> Table:
    """One row per part, for the terminal and for the sheet."""
    columns = (
        Column("id"), Column("name"), Column("x * y * z mm"), Column("diameter mm"), Column("triangles"),
        Column("watertight"), Column("symmetry"), Column("from"), Column("deviation mm", 2), Column("% of diameter", 2),
    )  # fmt: skip
    cells = tuple(
        (
            row.obj_id, row.name, " * ".join(f"{size:.1f}" for size in row.size_mm), row.diameter_mm, row.triangles,
            "yes" if row.watertight else "no", row.symmetry, "the shape" if row.proposed else "parts.yaml",
            row.deviation_mm if row.symmetry != "none" else None,
            row.deviation_percent if row.symmetry != "none" else None,
        )
        for row in rows
    )  # fmt: skip
    note = "deviation: 95 % of the surface come to lie at least this near to itself under all of the symmetries."
    return Table("Parts", columns, cells, note)


def _load(config: PartsConfig, parts: Path, pictures: Path) -> list[Mesh]:
    """The meshes in metres, cleaned, in the order of the parts.

    Raises:
        DataError: one is unreadable, or of a size that tells of a wrong unit.
    """
    meshes: list[Mesh] = []
    sizes: dict[str, tuple[float, Unit]] = {}
    for index, part in enumerate(config.parts):
        unit = part.unit or config.unit
        path = parts.parent / part.file
        # A folder each, for a picture is named after its mesh, and a.obj and a.glb would meet.
        mesh = cleaned(load_mesh(path, METRES[unit], pictures / str(index)), path)
        sizes[part.file] = mesh.diameter() / METRES[unit], unit
        meshes.append(mesh)
    require_plausible(sizes, str(parts))
    return meshes


def _row(part: PartConfig, unit: Unit, mesh: Mesh, symmetries: Symmetries, deviation: float) -> ImportedPart:
    assert part.obj_id is not None
    x, y, z = (float(v) for v in np.ptp(mesh.box, axis=0) / MILLIMETRE)
    return ImportedPart(
        obj_id=part.obj_id,
        name=part.name,
        file=part.file,
        unit=part.unit or unit,
        size_mm=(x, y, z),
        diameter_mm=mesh.diameter() / MILLIMETRE,
        triangles=len(mesh.faces),
        watertight=is_watertight(mesh),
        symmetry=in_words(symmetries),
        proposed=part.symmetries is None,
        deviation_mm=deviation / MILLIMETRE,
        statement=statement(symmetries, METRES[part.unit or unit]),
    )


def statement(symmetries: Symmetries, metres_per_unit: float) -> str:
    """Symmetries as one would write them beside a part in parts.yaml."""
    rows: list[str] = []
    for turn in generators(symmetries):
        kind = "continuous: true" if turn.fold == 0 else f"fold: {turn.fold}"
        offset = np.round(turn.offset / metres_per_unit, 4) + 0.0
        place = f", offset: {_numbers(offset)}" if offset.any() else ""
        rows.append(f"{{axis: {_numbers(np.round(turn.direction, 6) + 0.0)}, {kind}{place}}}")
    return f"symmetries: [{', '.join(rows)}]" if rows else "symmetries: none"


def _numbers(values: FloatArray) -> str:
    return "[" + ", ".join(f"{v:g}" for v in values) + "]"


def _copy_assemblies(config: PartsConfig, parts: Path, output: Path) -> None:
    """Copies the file of mounted groups that parts.yaml names, if the groups are of these parts."""
    if config.assemblies is None:
        return
    path = require_file(parts.parent / config.assemblies, "file of mounted groups")
    groups = read_json(path)
    known = {part.obj_id for part in config.parts}
    try:
        unknown = {part["obj_id"] for group in groups for part in group["parts"]} - known
    except (KeyError, TypeError) as error:
        raise DataError(f"{path} is no list of mounted groups: each needs `name` and `parts` with `obj_id`.") from error
    if unknown:
        raise DataError(f"{path} mounts obj_id {sorted(unknown)[0]}, but {parts} has {sorted(known)}.")
    write_json(output / "assemblies.json", groups, indent=1)
