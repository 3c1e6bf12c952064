"""The inspection sheet: one self-contained HTML page about a data set or a models folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from datagen.cad.clean import is_watertight
from datagen.cad.importer import ImportedPart, read_record, statement
from datagen.cad.symmetry import measure, propose
from datagen.cad.turns import in_words
from datagen.cad.units import METRES
from datagen.sheets.charts import class_chart, distribution_chart
from datagen.sheets.labels import Split, count_of_classes, find_splits, read_split, shown_pictures
from datagen.sheets.objects import object_views
from multicam import __version__
from multicam.dataset.objects import Catalogue, ObjectModel, load_catalogue
from multicam.files import require_folder, write_text
from multicam.geometry.mesh import Mesh
from multicam.progress import Progress
from multicam.visualization.pictures import data_uri


def write_sheet(data: Path, output: Path, progress: Progress) -> None:
    """Writes the page.

    Args:
        data: data set folder (models/ and splits) or BOP models folder.
        output: HTML file.

    Raises:
        DataError: no models there, or something that does not follow the BOP format.
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader

    require_folder(data, "data set or models folder")
    catalogue = load_catalogue(data)
    models = data / "models" if (data / "models").is_dir() else data
    records = {row.obj_id: row for row in read_record(models) or ()}
    objects = [
        _object_card(catalogue[obj_id], records.get(obj_id))
        for obj_id in progress.track(catalogue.obj_ids, "drawing objects", len(catalogue.obj_ids))
    ]
    splits = [split for path in find_splits(data) if (split := read_split(path, progress)).pictures]
    loader = ChoiceLoader([PackageLoader("datagen.sheets"), PackageLoader("multicam.visualization")])
    environment = Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    page = environment.get_template("sheet.html").render(
        title="Inspection sheet",
        folder=str(data),
        version=__version__,
        facts=_facts(catalogue, splits, objects),
        objects=objects,
        to_confirm=[card["name"] for card in objects if card["to_confirm"]],
        splits=[
            {
                "name": split.name,
                "summary": f"{len(split.pictures)} pictures in {split.scenes} scenes",
                "pictures": shown_pictures(split, catalogue, progress),
            }
            for split in splits
        ],
        **_charts(splits, catalogue),
    )
    write_text(output, page)


def _charts(splits: Sequence[Split], catalogue: Catalogue) -> dict[str, str | None]:
    if not splits:
        return {"class_chart": None, "distribution_chart": None}
    return {
        "class_chart": data_uri(class_chart(count_of_classes(splits, catalogue)), "svg+xml"),
        "distribution_chart": data_uri(distribution_chart(splits), "svg+xml"),
    }


def _facts(catalogue: Catalogue, splits: Sequence[Split], objects: Sequence[dict[str, Any]]) -> list[str]:
    diameters = sorted((model.diameter, model.name) for model in catalogue.objects.values())
    (small, least), (large, most) = diameters[0], diameters[-1]
    facts = [
        f"{len(objects)} object{'s' if len(objects) != 1 else ''}, {small * 1000:.0f} mm ({_spoken(least)}) to "
        f"{large * 1000:.0f} mm ({_spoken(most)}) across. Is that so? Then the units are right."
    ]
    for split in splits:
        seed = "" if split.seed is None else f", seed {split.seed}"
        facts.append(
            f"{split.name}: {len(split.pictures)} pictures in {split.scenes} scenes, {len(split.instances)} labelled "
            f"objects{seed}."
        )
    return facts


def _object_card(model: ObjectModel, record: ImportedPart | None) -> dict[str, Any]:
    """What the template shows of one object.

    Raises:
        DataError: it has no mesh.
    """
    mesh = model.load_mesh()
    x, y, z = (float(v) * 1000 for v in mesh.box[1] - mesh.box[0])
    return {
        "obj_id": model.obj_id,
        "name": _spoken(model.name),
        "views": object_views(model, mesh),
        "rows": [
            ("size", f"{x:.1f} × {y:.1f} × {z:.1f} mm"),
            ("diameter", f"{model.diameter * 1000:.1f} mm"),
            ("surface", f"{len(mesh.faces)} triangles, {'closed' if is_watertight(mesh) else 'with gaps'}"),
            (
                "looks",
                "picture" if mesh.texture else "colours of vertices" if mesh.colors is not None else "no colours",
            ),
            ("keypoints", "none" if model.keypoints is None else str(len(model.keypoints))),
            *([("file", f"{record.file}, in {record.unit}")] if record else []),
        ],
        **_symmetry_rows(model, mesh, record),
    }


def _symmetry_rows(model: ObjectModel, mesh: Mesh, record: ImportedPart | None) -> dict[str, Any]:
    """The symmetries in use, how exact they are, and what the shape alone suggests."""
    words = in_words(model.symmetries)
    if record is not None:
        deviation = record.deviation_mm
    else:
        deviation = measure(mesh, model.symmetries).deviation * 1000
    miss = f"{deviation:.2f} mm, {deviation / model.diameter / 10:.2f} % of the diameter" if model.symmetries else None
    if record is not None and record.proposed:
        return {"symmetry": words, "miss": miss, "to_confirm": True, "hint": None, "statement": record.statement}
    found = propose(mesh)
    hint = None
    if in_words(found.symmetries) != words:
        share = 100 * found.deviation / model.diameter
        looks = f"{in_words(found.symmetries)} (deviation {share:.2f} %)" if found.symmetries else "no symmetry"
        hint = f"By its shape alone it has: {looks}. A print may break that, or the maker judged otherwise."
    metres = METRES["mm"]
    return {
        "symmetry": words,
        "miss": miss,
        "to_confirm": False,
        "hint": hint,
        "statement": statement(model.symmetries, metres),
    }


def _spoken(name: str) -> str:
    return name.replace("_", " ")
