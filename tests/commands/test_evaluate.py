from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from multicam import cli
from multicam.commands.evaluate import EvaluateConfig
from multicam.config import load_config
from multicam.dataset.results import write_results
from multicam.dataset.runs import write_run
from multicam.types import ObjectEstimate
from tests.toy_recording import truthful_run
from tests.toy_walk import HEADSET, LEFT, RIGHT

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def run_folder(toy_recording, tmp_path):
    """The folder of a perfect run."""
    write_run(tmp_path / "run" / "results.json", truthful_run(toy_recording, placed_from=1))
    write_results(tmp_path / "run" / "estimates.csv", [])
    return tmp_path / "run"


@pytest.fixture
def candidates(toy_recording, tmp_path):
    """The truth as a results file."""
    rows = [
        (record.scene_id, record.im_id, ObjectEstimate(i.obj_id, 0.9, i.camera_from_object), 0.1)
        for camera in toy_recording.cameras
        for record in (toy_recording.record(camera.camera_id, e.im_id) for e in camera.frames)
        for i in record.instances
    ]
    write_results(tmp_path / "candidates.csv", rows)
    return tmp_path / "candidates.csv"


def refused(capsys, *flags: str) -> str:
    assert cli.run(["evaluate", *flags]) == 2
    printed = capsys.readouterr()
    assert "Traceback" not in printed.err
    lines = [line for line in printed.err.splitlines() if line.startswith("multicam evaluate: ")]
    assert len(lines) == 1
    return lines[0]


def test_a_run_is_judged_against_its_recording(run_folder, capsys):
    assert cli.run(["evaluate", "--run", str(run_folder)]) == 0
    printed = capsys.readouterr().out
    for text in ("Camera errors", f"{LEFT} in {HEADSET}", f"{RIGHT} in {LEFT}", "Coverage", "Time per step", "peg"):
        assert text in printed
    tables = {t["title"]: t["rows"] for t in json.loads((run_folder / "evaluation.json").read_text())}
    assert tables["Camera errors"][0]["median mm"] == pytest.approx(0, abs=1e-4)
    assert tables["Camera errors"][0]["has pose %"] == pytest.approx(100 * 5 / 6)
    assert "<caption>Camera errors</caption>" in (run_folder / "report.html").read_text()
    assert (run_folder / "evaluation-camera-errors.csv").read_text().startswith("camera,has pose %")


def test_a_recording_that_moved_can_be_named(run_folder, toy_recording, tmp_path):
    moved = shutil.copytree(toy_recording.folder, tmp_path / "moved")
    path = run_folder / "results.json"
    path.write_text(path.read_text().replace(str(toy_recording.folder), "/somewhere/else"))
    assert cli.run(["evaluate", "--run", str(run_folder)]) == 2
    assert cli.run(["evaluate", "--run", str(run_folder), "--recording", str(moved)]) == 0


def test_a_recording_without_truth_is_refused(run_folder, toy_recording, tmp_path, capsys):
    moved = shutil.copytree(toy_recording.folder, tmp_path / "moved")
    for path in moved.glob("test/*/scene_camera.json"):
        content = json.loads(path.read_text())
        for row in content.values():
            del row["cam_R_w2c"], row["cam_t_w2c"]
        path.write_text(json.dumps(content))
    sentence = refused(capsys, "--run", str(run_folder), "--recording", str(moved))
    assert "has no true poses" in sentence
    assert not (run_folder / "evaluation.json").exists()


def test_candidates_are_judged_per_object(candidates, toy_recording, capsys):
    flags = ("--candidates", str(candidates), "--dataset", str(toy_recording.folder))
    assert cli.run(["evaluate", *flags]) == 0
    assert "Single-view object errors" in capsys.readouterr().out
    (table,) = json.loads((candidates.parent / "evaluation.json").read_text())
    assert {row["within 0.1 d %"] for row in table["rows"]} == {100}


def test_nothing_or_both_to_judge_is_refused(capsys):
    for flags in ((), ("--run", "a", "--candidates", "b"), ("--candidates", "b")):
        assert "give either --run DIR, or --candidates" in refused(capsys, *flags)


def test_a_folder_that_is_no_run_is_refused(tmp_path, capsys):
    assert "does not exist" in refused(capsys, "--run", str(tmp_path / "nowhere"))
    (tmp_path / "results.json").write_text("{}")
    assert "is not the result of a run" in refused(capsys, "--run", str(tmp_path))
    (tmp_path / "results.json").write_text("{,")
    assert "is not valid JSON" in refused(capsys, "--run", str(tmp_path))


def test_candidates_with_nan_or_of_another_data_set_are_refused(candidates, toy_recording, tmp_path, capsys):
    flags = ("--dataset", str(toy_recording.folder))
    bad = tmp_path / "bad.csv"
    lines = candidates.read_text().splitlines()
    cells = lines[3].split(",")
    cells[5] = "nan 0 0"
    bad.write_text("\n".join([*lines[:3], ",".join(cells)]))
    assert "line 4: pose holds NaN" in refused(capsys, "--candidates", str(bad), *flags)
    bad.write_text("\n".join([lines[0], lines[1].replace("0,", "77,", 1)]))
    assert "scene 77" in refused(capsys, "--candidates", str(bad), *flags)
    missing = refused(capsys, "--candidates", str(candidates), "--dataset", str(toy_recording.folder), "--split", "val")
    assert "val does not exist" in missing


def test_wrong_units_of_a_model_are_refused(candidates, toy_recording, tmp_path, capsys):
    moved = shutil.copytree(toy_recording.folder, tmp_path / "metres")
    info = json.loads((moved / "models" / "models_info.json").read_text())
    for row in info.values():
        row["diameter"] /= 1000
    (moved / "models" / "models_info.json").write_text(json.dumps(info))
    sentence = refused(capsys, "--candidates", str(candidates), "--dataset", str(moved))
    assert "is it in metres?" in sentence


@pytest.mark.parametrize("path", sorted((ROOT / "configs" / "evaluate").glob("*.yaml")), ids=lambda path: path.stem)
def test_the_configurations_of_the_repository_fit(path):
    assert load_config(EvaluateConfig, path).dataset is not None
