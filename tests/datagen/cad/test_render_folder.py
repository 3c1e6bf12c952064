"""One command from foreign CAD to labelled pictures and a sheet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from datagen.cli import main
from multicam.dataset.bop_reader import list_scenes, read_image, read_scene
from multicam.errors import DataError
from tests.toy_objects import BRACKET, PLATE, WEDGE, toy_meshes


@pytest.mark.blender
def test_a_folder_of_cad_goes_to_pictures_and_a_sheet_in_one_command(tmp_path: Path) -> None:
    cad, output = tmp_path / "cad", tmp_path / "data"
    cad.mkdir()
    for obj_id, name in ((BRACKET, "bracket.stl"), (PLATE, "plate.obj"), (WEDGE, "wedge.glb")):
        mesh = toy_meshes()[obj_id]
        colors = np.full((len(mesh.vertices), 3), (200, 40, 40), dtype=np.uint8)
        made = trimesh.Trimesh(mesh.vertices * 1000, mesh.faces, vertex_colors=colors, process=False)
        made.export(cad / name)
    (cad / "parts.yaml").write_text("unit: mm\n")
    flags = ["--models", str(cad), "--output", str(output), "--images", "4", "--images-per-scene", "2"]
    flags += ["--width", "64", "--height", "48", "--samples", "1", "--objects.loose", "3", "4"]
    main(["render", *flags])
    records = [record for scene in list_scenes(output / "train") for record in read_scene(scene)]
    assert len(records) == 4
    assert {i.obj_id for record in records for i in record.instances} <= {1, 2, 3}
    assert sum(len(record.instances) for record in records) >= 4
    assert records[0].rgb_path is not None
    assert read_image(records[0].rgb_path).shape == (48, 64, 3)
    page = (output / "inspect.html").read_text()
    assert "train: 4 pictures in 2 scenes" in page
    assert "please confirm" in page
    # Again: nothing is left to do. With other parts: refused before anything is rendered.
    main(["render", *flags])
    (cad / "parts.yaml").write_text("unit: cm\n")
    with pytest.raises(DataError, match="holds other models"):
        main(["render", *flags])
