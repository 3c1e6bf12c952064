from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multicam import cli
from multicam.commands.evaluate import EvaluateConfig
from multicam.config import load_config
from multicam.dataset.results import read_results, write_results
from multicam.dataset.runs import AdjustmentResult, write_run
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


def test_one_stage_of_a_run_can_be_looked_at_alone(run_folder, toy_recording, capsys):
    flags = ["evaluate", "--run", str(run_folder), "--stage"]
    assert cli.run([*flags, "graph"]) == 0
    printed = capsys.readouterr().out
    assert "Camera errors" in printed and "Single" not in printed
    assert "no step of" in refused(capsys, *flags[1:], "bundle")
    run = truthful_run(toy_recording)
    steps = tuple(
        replace(step, adjustment=AdjustmentResult(step.cameras, step.objects, (2.0, 1.0), {})) for step in run.steps
    )
    write_run(run_folder / "results.json", replace(run, steps=steps))
    assert cli.run([*flags, "bundle"]) == 0
    printed = capsys.readouterr().out
    assert "Bundle adjustment" in printed and "Camera errors" not in printed
    assert "<caption>Bundle adjustment</caption>" in (run_folder / "report.html").read_text()


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
    tables = {t["title"]: t["rows"] for t in json.loads((candidates.parent / "evaluation.json").read_text())}
    assert {row["within 0.1 d %"] for row in tables["Single-view object errors"]} == {100}
    assert tables["Single-view object errors"][-1]["AR VSD %"] == pytest.approx(100)
    assert "Detection" not in tables
    assert "The worst cases" in (candidates.parent / "evaluation.html").read_text()
    saved = load_config(EvaluateConfig, candidates.parent / "evaluation.config.yaml")
    assert (saved.candidates, saved.split) == (candidates, "test")


def test_a_network_is_run_on_a_split_and_judged(marked, tmp_path, capsys):
    flags = ("--network", str(marked.network), "--dataset", str(marked.recording), "--output", str(tmp_path))
    assert cli.run(["evaluate", *flags]) == 0
    assert "Keypoints" in capsys.readouterr().out
    tables = {t["title"]: t["rows"] for t in json.loads((tmp_path / "evaluation.json").read_text())}
    # The toy network answers with the labels; its 32-bit pixels cost little.
    assert tables["Single-view object errors"][-1]["within 0.1 d %"] == 100
    assert tables["Detection"][-1]["AP50 %"] == tables["Detection"][-1]["recall %"] == 100
    assert tables["Keypoints"][-1]["median px"] < 0.1
    assert tables["Pose uncertainty"][-1]["inside 95 %"] == 100
    assert "Stated against true uncertainty" in (tmp_path / "evaluation.html").read_text()
    # What was written is what the other mode reads, with and without covariances.
    plain, sure = (read_results(tmp_path / name) for name in ("estimates.csv", "estimates_covariance.csv"))
    assert {key: len(found) for key, found in plain.items()} == {key: len(found) for key, found in sure.items()}
    assert all(estimate.covariance is not None for found in sure.values() for estimate in found)
    again = ("--candidates", str(tmp_path / "estimates.csv"), "--dataset", str(marked.recording))
    assert cli.run(["evaluate", *again, "--output", str(tmp_path / "again")]) == 0
    rows = json.loads((tmp_path / "again" / "evaluation.json").read_text())[0]["rows"]
    for row, other in zip(rows, tables["Single-view object errors"], strict=True):
        assert row == pytest.approx(other, abs=1e-2)


def test_a_limit_judges_that_many_images(marked, tmp_path, capsys):
    flags = ("--network", str(marked.network), "--dataset", str(marked.recording), "--output", str(tmp_path))
    assert cli.run(["evaluate", *flags, "--limit", "4"]) == 0
    assert "in 4 pictures" in capsys.readouterr().out
    images = {line.split(",")[0] for line in (tmp_path / "estimates.csv").read_text().splitlines()[1:]}
    assert images == {"0", "1", "2"}
    assert "--limit is 0" in refused(capsys, *flags, "--limit", "0")


def test_objects_can_be_selected_by_distance_and_visibility(candidates, toy_recording, tmp_path, capsys):
    flags = ("--candidates", str(candidates), "--dataset", str(toy_recording.folder), "--output", str(tmp_path))

    def asked(*more: str) -> int:
        assert cli.run(["evaluate", *flags, *more]) == 0
        capsys.readouterr()
        return json.loads((tmp_path / "evaluation.json").read_text())[0]["rows"][-1]["asked"]

    instances = [i for c in toy_recording.cameras for e in c.frames
                 for i in toy_recording.record(c.camera_id, e.im_id).instances]  # fmt: skip
    near = [i for i in instances if np.linalg.norm(i.camera_from_object[:3, 3]) < 1.0]
    assert 0 < len(near) < len(instances)
    assert asked("--distance", "0", "1.0") == sum(i.visible_fraction >= 0.1 for i in near)
    assert asked("--least-visible", "0.9") == sum(i.visible_fraction >= 0.9 for i in instances)
    assert "hold nothing" in refused(capsys, *flags, "--distance", "1", "0.5")
    assert "is 50 to 60 m away" in refused(capsys, *flags, "--distance", "50", "60")
    assert "must be 0.1 to 1" in refused(capsys, *flags, "--least-visible", "50")


def test_a_network_for_other_objects_or_a_file_that_is_none_is_refused(marked, tmp_path, capsys):
    flags = ("--dataset", str(marked.recording), "--output", str(tmp_path / "out"))
    (tmp_path / "no.onnx").write_bytes(b"nothing")
    assert "cannot be opened" in refused(capsys, "--network", str(tmp_path / "no.onnx"), *flags)
    moved = shutil.copytree(marked.recording, tmp_path / "moved")
    info = json.loads((moved / "models" / "models_info.json").read_text())
    info.pop(max(info))
    (moved / "models" / "models_info.json").write_text(json.dumps(info))
    keypoints = json.loads((moved / "models" / "keypoints.json").read_text())
    keypoints.pop(max(keypoints))
    (moved / "models" / "keypoints.json").write_text(json.dumps(keypoints))
    message = refused(capsys, "--network", str(marked.network), "--dataset", str(moved), *flags[2:])
    assert "lacks: run it on pictures of the objects it was trained on" in message
    assert not (tmp_path / "out").exists()


def test_a_split_without_truth_or_without_visible_fractions_is_refused(candidates, toy_recording, tmp_path, capsys):
    moved = shutil.copytree(toy_recording.folder, tmp_path / "blind")
    flags = ("--candidates", str(candidates), "--dataset", str(moved))
    for path in moved.glob("test/*/scene_gt_info.json"):
        path.unlink()
    assert "lacks scene_gt_info.json" in refused(capsys, *flags, "--least-visible", "0.5")
    for path in moved.glob("test/*/scene_gt.json"):
        path.unlink()
    assert "have no true poses" in refused(capsys, *flags)


def test_estimates_in_metres_are_refused(candidates, toy_recording, tmp_path, capsys):
    lines = candidates.read_text().splitlines()
    for number, line in enumerate(lines[1:], start=1):
        cells = line.split(",")
        cells[5] = " ".join(str(float(value) / 1000) for value in cells[5].split())
        lines[number] = ",".join(cells)
    (tmp_path / "metres.csv").write_text("\n".join(lines))
    flags = ("--candidates", str(tmp_path / "metres.csv"), "--dataset", str(toy_recording.folder))
    assert "are they in metres?" in refused(capsys, *flags)


def test_nothing_or_both_to_judge_is_refused(capsys):
    for flags in (
        (),
        ("--run", "a", "--candidates", "b"),
        ("--candidates", "b"),
        ("--network", "n", "--candidates", "b"),
    ):
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
