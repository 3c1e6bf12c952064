"""Real photographs and a published method's estimates: what the figures must be whatever the pictures."""

from __future__ import annotations

from pathlib import Path

import pytest

from multicam.dataset.objects import load_catalogue
from multicam.dataset.results import Estimates, read_results, write_results
from multicam.evaluation.points import PointSets
from multicam.evaluation.selection import Selection
from multicam.evaluation.single_view import read_split
from multicam.evaluation.split_error import SplitErrors, evaluate_split
from multicam.evaluation.split_report import split_tables
from multicam.progress import SilentProgress
from multicam.types import ObjectEstimate

EVERY = 16
"""Of the pictures, to save time."""


@pytest.fixture(scope="module")
def photographs(bench_dir: Path):
    catalogue = load_catalogue(bench_dir / "lmo")
    return read_split(bench_dir / "lmo" / "test", {})[::EVERY], PointSets(catalogue)


def judge(photographs, estimates: Estimates) -> SplitErrors:
    records, points = photographs
    return evaluate_split(records, estimates, None, points, Selection(), SilentProgress())


def test_the_truth_read_from_a_results_file_is_perfect_in_every_figure(photographs, tmp_path):
    rows = [
        (r.scene_id, r.im_id, ObjectEstimate(i.obj_id, 1.0, i.camera_from_object), -1.0)
        for r in photographs[0]
        for i in r.instances
    ]
    write_results(tmp_path / "truth.csv", rows)
    for table in split_tables(judge(photographs, read_results(tmp_path / "truth.csv"))):
        figures = [
            row[c.name]
            for row in table.to_plain()["rows"]
            if row.get("asked", 1)
            for c in table.columns
            if "%" in c.name
        ]
        # The file keeps nine digits of a rotation, which costs a millionth of the area.
        assert figures == pytest.approx([100] * len(figures), abs=1e-4)


def test_poses_as_the_labels_have_them_are_exactly_perfect(photographs):
    truth = {
        (r.scene_id, r.im_id): [ObjectEstimate(i.obj_id, 1.0, i.camera_from_object) for i in r.instances]
        for r in photographs[0]
    }
    rows = split_tables(judge(photographs, truth))[0].to_plain()["rows"]
    names = ("found %", "within 0.1 d %", "AR MSSD %", "AR MSPD %", "AR without VSD %")
    assert all(row[name] == 100 for row in rows for name in names)


def test_rows_in_another_order_give_identical_figures(photographs, bench_dir, rng):
    estimates = read_results(bench_dir / "lmo" / "results" / "megapose_lmo-test.csv.gz")
    shuffled = {key: [found[i] for i in rng.permutation(len(found))] for key, found in estimates.items()}
    first, second = (split_tables(judge(photographs, some)) for some in (estimates, shuffled))
    assert [t.to_csv() for t in first] == [t.to_csv() for t in second]
    mean = first[0].to_plain()["rows"][-1]
    assert 20 < mean["within 0.1 d %"] < 60
    # MegaPose places many objects well in the picture and badly in depth.
    assert mean["AR MSPD %"] > mean["AR MSSD %"] > 20
