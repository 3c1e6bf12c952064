from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from multicam import cli
from multicam.commands.run import RunConfig, run_recording
from multicam.config import load_config
from multicam.dataset.bop_reader import read_image
from multicam.dataset.results import read_results
from multicam.dataset.runs import read_run
from multicam.dataset.sequence import load_recording
from multicam.inference.estimator import FrameEstimates
from multicam.progress import SilentProgress
from tests.commands.conftest import Marked
from tests.inference.toy_network import toy_metadata, write_network
from tests.toy_recording import truthful_estimator
from tests.toy_walk import HEADSET, LEFT, RIGHT

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def finished(marked: Marked, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run with the toy network, through the command line."""
    output = tmp_path_factory.mktemp("run") / "out"
    code = cli.run(
        ["run", "--recording", str(marked.recording), "--network", str(marked.network), "--output", str(output)]
    )
    assert code == 0
    return output


@pytest.fixture
def copied(marked: Marked, tmp_path: Path) -> Path:
    """A copy of the recording to break."""
    return Path(shutil.copytree(marked.recording, tmp_path / "recording"))


def refused(capsys: pytest.CaptureFixture[str], tmp_path: Path, recording: Path, network: Path) -> str:
    """Runs on bad input; returns the one sentence, after checking that nothing was written and nothing crashed."""
    output = tmp_path / "out"
    code = cli.run(["run", "--recording", str(recording), "--network", str(network), "--output", str(output)])
    printed = capsys.readouterr().err
    assert code == 2
    assert "Traceback" not in printed
    assert not output.exists()
    sentences = [line for line in printed.splitlines() if line.startswith("multicam run: ")]
    assert len(sentences) == 1
    return sentences[0]


def test_both_cameras_are_placed_from_pictures_alone(finished, marked):
    run, recording = read_run(finished / "results.json"), load_recording(marked.recording)
    assert run.complete
    assert run.headset == HEADSET
    last = run.steps[-1]
    for name in (LEFT, RIGHT):
        truth = recording.truth_of(name, 0)
        # Keypoints pass through 32-bit pixels of a 64 px wide input; contours are read off pictures of 160 px.
        np.testing.assert_allclose(last.camera(name).world_from_camera, truth, atol=4e-3)
    assert set(last.seconds) == {"network", "pnp", "graph", "bundle"}
    assert run.steps[0].adjustment is not None
    assert len(last.objects) == 10


def test_estimates_are_brought_to_depth_where_asked_for(marked, tmp_path):
    flags = ["--network", str(marked.network), "--recording", str(marked.recording), "--output", str(tmp_path)]
    assert cli.run(["run", *flags, "--fit.enabled"]) == 0
    last, recording = read_run(tmp_path / "results.json").steps[-1], load_recording(marked.recording)
    assert last.seconds["fit"] > 0
    for name in (LEFT, RIGHT):
        truth = recording.truth_of(name, 0)
        np.testing.assert_allclose(last.camera(name).world_from_camera, truth, atol=4e-3)


def test_bundle_adjustment_can_be_left_out_and_is_left_out_without_depth(marked, copied, tmp_path):
    flags = ["run", "--network", str(marked.network), "--output", str(tmp_path / "out")]
    assert cli.run([*flags, "--recording", str(marked.recording), "--pipeline.bundle.no-enabled"]) == 0
    plain = read_run(tmp_path / "out" / "results.json")
    for depth in copied.glob("test/*/depth"):
        shutil.rmtree(depth)
    assert cli.run([*flags, "--recording", str(copied)]) == 0
    blind = read_run(tmp_path / "out" / "results.json")
    for step in (*plain.steps, *blind.steps):
        assert step.adjustment is None and "bundle" not in step.seconds


def test_everything_promised_is_written(finished, marked):
    for step in range(6):
        for name in (HEADSET, LEFT, RIGHT):
            assert read_image(finished / "overlays" / name / f"{step:06d}.jpg").shape[2] == 3
    assert read_image(finished / "top_view.png").size
    page = (finished / "report.html").read_text()
    assert "Coverage over time" in page
    saved = load_config(RunConfig, finished / "config.yaml")
    assert (saved.recording, saved.network) == (marked.recording, marked.network)
    estimates, recording = read_results(finished / "estimates.csv"), load_recording(marked.recording)
    truths = {i.obj_id: i.camera_from_object for i in recording.record(LEFT, 3).instances}
    for estimate in estimates[1, 3]:
        np.testing.assert_allclose(estimate.camera_from_object[:3, 3], truths[estimate.obj_id][:3, 3], atol=2e-3)
    sure = read_results(finished / "estimates_covariance.csv")
    assert estimates.keys() == sure.keys()
    assert all(estimate.covariance is not None for found in sure.values() for estimate in found)


def test_ctrl_c_keeps_what_was_computed(toy_recording, tmp_path, capsys):
    truth = truthful_estimator(toy_recording, np.random.default_rng(0))
    calls = []

    def impatient(frames):
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return truth(frames)

    config = RunConfig(toy_recording.folder, Path("toy.onnx"), tmp_path)
    with pytest.raises(KeyboardInterrupt):
        run_recording(toy_recording, impatient, toy_recording.catalogue, config, SilentProgress())
    run = read_run(tmp_path / "results.json")
    assert not run.complete
    assert len(run.steps) == 3
    # The rest can be made of it later.
    assert cli.run(["evaluate", "--run", str(tmp_path)]) == 0
    assert "The run was interrupted" in capsys.readouterr().out
    assert (tmp_path / "report.html").is_file()


def test_ctrl_c_before_the_first_step_leaves_nothing(toy_recording, tmp_path):
    def impatient(frames):
        raise KeyboardInterrupt

    config = RunConfig(toy_recording.folder, Path("toy.onnx"), tmp_path / "out")
    with pytest.raises(KeyboardInterrupt):
        run_recording(toy_recording, impatient, toy_recording.catalogue, config, SilentProgress())
    assert not (tmp_path / "out").exists()


def test_a_network_that_finds_nothing_gives_a_report_that_says_so(marked, tmp_path):
    recording = load_recording(marked.recording)

    def blind(frames):
        return [FrameEstimates((), ())] * len(frames), {"network": 0.0, "pnp": 0.0}

    config = RunConfig(marked.recording, marked.network, tmp_path)
    run = run_recording(recording, blind, recording.catalogue, config, SilentProgress())
    assert {step.camera(LEFT).status for step in run.steps} == {"not placed"}
    page = (tmp_path / "report.html").read_text()
    assert f"Camera {LEFT} was never placed." in page


def test_results_do_not_depend_on_what_was_in_the_folder(marked, tmp_path):
    recording = load_recording(marked.recording)
    estimate = truthful_estimator(recording, np.random.default_rng(0))
    config = RunConfig(marked.recording, marked.network, tmp_path)
    stale = tmp_path / "overlays" / "other" / "000000.jpg"
    stale.parent.mkdir(parents=True)
    stale.write_bytes(b"old")
    run_recording(recording, estimate, recording.catalogue, config, SilentProgress())
    assert not stale.exists()


def test_a_missing_recording(capsys, tmp_path, marked):
    sentence = refused(capsys, tmp_path, tmp_path / "nowhere", marked.network)
    assert "nowhere/sequence.json does not exist" in sentence


def test_a_malformed_sequence(capsys, tmp_path, marked, copied):
    (copied / "sequence.json").write_text('{"format": "multicam-sequence", "version": 1, "cameras": [')
    assert "sequence.json is not valid JSON" in refused(capsys, tmp_path, copied, marked.network)


def test_a_sequence_with_a_nan_pose(capsys, tmp_path, marked, copied):
    content = json.loads((copied / "sequence.json").read_text())
    content["cameras"][0]["frames"][0]["tracked_world_from_camera"][0][3] = float("nan")
    (copied / "sequence.json").write_text(json.dumps(content))
    assert "the tracked pose of image 0 is no 4x4 rigid transform" in refused(capsys, tmp_path, copied, marked.network)


def test_an_empty_recording(capsys, tmp_path, marked, copied):
    content = json.loads((copied / "sequence.json").read_text())
    for camera in content["cameras"]:
        camera["frames"] = []
    (copied / "sequence.json").write_text(json.dumps(content))
    assert "holds no pictures" in refused(capsys, tmp_path, copied, marked.network)


@pytest.mark.parametrize(("moving", "count"), [((), "0 moving cameras (none)"), ((0, 1), "2 moving cameras")])
def test_exactly_one_headset_is_needed(capsys, tmp_path, marked, copied, moving, count):
    content = json.loads((copied / "sequence.json").read_text())
    for index, camera in enumerate(content["cameras"]):
        camera["kind"] = "headset" if index in moving else "static"
    (copied / "sequence.json").write_text(json.dumps(content))
    assert count in refused(capsys, tmp_path, copied, marked.network)


def test_a_truncated_image(capsys, tmp_path, marked, copied):
    picture = copied / "test" / "000001" / "rgb" / "000003.jpg"
    picture.write_bytes(picture.read_bytes()[:-200])
    assert "000003.jpg is not a readable image" in refused(capsys, tmp_path, copied, marked.network)


def test_a_missing_network(capsys, tmp_path, marked):
    assert "none.onnx does not exist" in refused(capsys, tmp_path, marked.recording, tmp_path / "none.onnx")


def test_an_onnx_file_that_is_not_ours(capsys, tmp_path, marked):
    value = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1])
    result = helper.make_tensor_value_info("y", TensorProto.FLOAT, [1])
    graph = helper.make_graph([helper.make_node("Relu", ["x"], ["y"])], "other", [value], [result])
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), tmp_path / "o.onnx")
    assert "not one of ours" in refused(capsys, tmp_path, marked.recording, tmp_path / "o.onnx")


def test_a_network_of_other_objects(capsys, tmp_path, marked, catalogue):
    from tests.commands.conftest import _table

    models = {**catalogue.objects, 99: replace(catalogue[1], obj_id=99, name="spanner")}
    metadata = toy_metadata(replace(catalogue, objects=models)).to_json()
    other = write_network(tmp_path / "other.onnx", _table(load_recording(marked.recording)), metadata)
    assert "knows object 99 (spanner)" in refused(capsys, tmp_path, marked.recording, other)
    scaled = {i: replace(m, diameter=2 * m.diameter) if i == 1 else m for i, m in catalogue.objects.items()}
    metadata = toy_metadata(replace(catalogue, objects=scaled)).to_json()
    other = write_network(tmp_path / "scaled.onnx", _table(load_recording(marked.recording)), metadata)
    assert "object 1 is bracket" in refused(capsys, tmp_path, marked.recording, other)


def test_a_misspelt_flag_is_refused(capsys, marked):
    with pytest.raises(SystemExit) as stopped:
        cli.run(["run", "--recordnig", str(marked.recording)])
    assert stopped.value.code == 2
    assert "--recording" in capsys.readouterr().err


@pytest.mark.parametrize("path", sorted((ROOT / "configs" / "run").glob("*.yaml")), ids=lambda path: path.stem)
def test_the_configurations_of_the_repository_fit(path):
    assert load_config(RunConfig, path) is not None


def test_every_step_can_be_watched(toy_recording, tmp_path):
    estimate = truthful_estimator(toy_recording, np.random.default_rng(0))
    config = RunConfig(toy_recording.folder, Path("toy.onnx"), tmp_path)
    watched = []

    def watch(step, frames):
        watched.append((step.timestamp_ns, [frame.camera_id for frame in frames]))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_recording(toy_recording, estimate, toy_recording.catalogue, config, SilentProgress(), watch)
    assert watched == [(0, [HEADSET, LEFT, RIGHT])]
