import csv
import io
import json

import pytest

from multicam.evaluation.report import Column, Table, mean_cell, render_text, save_report

TABLE = Table(
    "Camera errors",
    (Column("camera"), Column("median mm", 1), Column("steps", 0)),
    (("left", 12.3456, 20), ("a <b>", float("inf"), 3), ("none", None, 0)),
    "Against truth.",
)


def test_text_is_aligned_and_shows_a_dash_where_there_is_no_number():
    assert TABLE.to_text().splitlines() == [
        "Camera errors",
        "camera  median mm  steps",
        "------  ---------  -----",
        "left         12.3     20",
        "a <b>           -      3",
        "none            -      0",
        "Against truth.",
    ]


def test_csv_keeps_full_precision():
    rows = list(csv.reader(io.StringIO(TABLE.to_csv())))
    assert rows[0] == ["camera", "median mm", "steps"]
    assert rows[1] == ["left", "12.3456", "20"]
    assert rows[2] == ["a <b>", "", "3"]


def test_plain_form_is_json_without_infinity():
    text = json.dumps(TABLE.to_plain(), allow_nan=False)
    assert json.loads(text)["rows"][1] == {"camera": "a <b>", "median mm": None, "steps": 3}


def test_html_escapes_text_and_marks_numbers():
    html = TABLE.to_html()
    assert "a &lt;b&gt;" in html
    assert '<td class="number">12.3</td>' in html
    assert "<caption>Camera errors</caption>" in html


def test_a_row_of_the_wrong_length_is_our_mistake():
    with pytest.raises(ValueError, match="has 1 cells for 2 columns"):
        Table("t", (Column("a"), Column("b")), (("x",),))


def test_all_forms_are_written(tmp_path):
    save_report(tmp_path, "evaluation", [TABLE])
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "evaluation-camera-errors.csv",
        "evaluation.json",
        "evaluation.txt",
    ]
    assert (tmp_path / "evaluation.txt").read_text() == render_text([TABLE])


def test_the_mean_of_cells_skips_text():
    assert mean_cell([1.0, 3, "x", None]) == 2.0
