from dataclasses import replace

import numpy as np
import pytest

from multicam.dataset.bop_writer import pose_row
from multicam.dataset.runs import AdjustmentResult, RunResult, StepResult, read_run, write_run
from multicam.dataset.sequence import Recording, load_recording
from multicam.dataset.units import transform_from_bop
from multicam.errors import DataError
from multicam.evaluation.run_error import RunErrors, evaluate_run
from multicam.evaluation.tables import (
    adjustment_table,
    camera_table,
    coverage_table,
    object_table,
    statements,
    time_table,
)
from multicam.geometry import se3
from multicam.progress import SilentProgress
from tests.faults import edit_json
from tests.toy_recording import truth_as_estimates, truthful_run, write_toy_recording
from tests.toy_walk import HEADSET, LEFT, RIGHT


def moved(run: RunResult, camera_id: str, twist: list[float]) -> RunResult:
    """The run with one camera's pose perturbed on the right at every step."""

    def change(step: StepResult) -> StepResult:
        cameras = tuple(
            replace(c, world_from_camera=se3.plus(c.world_from_camera, np.array(twist)))
            if c.camera_id == camera_id and c.world_from_camera is not None
            else c
            for c in step.cameras
        )
        return replace(step, cameras=cameras)

    return replace(run, steps=tuple(map(change, run.steps)))


def judge(run: RunResult, recording: Recording) -> RunErrors:
    """Errors with the truth as the network's estimates."""
    return evaluate_run(run, truth_as_estimates(recording), recording, SilentProgress())


def test_a_perfect_run_has_no_errors(toy_recording):
    errors = judge(truthful_run(toy_recording), toy_recording)
    for series in (*errors.cameras.values(), *errors.pairs.values()):
        assert all(e is not None and e.centre_mm < 1e-6 and e.rotation_deg < 1e-5 and e.inside for e in series)
    assert all(max(found) < 1e-6 for found in errors.objects.values())


def test_an_error_of_a_static_camera_shows_in_the_headsets_frame(toy_recording):
    errors = judge(moved(truthful_run(toy_recording), LEFT, [0, 0, 0.1, 0.03, 0.04, 0]), toy_recording)
    assert errors.cameras[LEFT][0].centre_mm == pytest.approx(50, abs=0.1)
    assert errors.cameras[LEFT][0].rotation_deg == pytest.approx(np.degrees(0.1))
    assert not errors.cameras[LEFT][0].inside
    assert errors.cameras[RIGHT][0].centre_mm < 1e-6
    assert errors.pairs[LEFT, RIGHT][0].rotation_deg == pytest.approx(np.degrees(0.1))


def test_adjusted_steps_are_judged_before_and_after(toy_recording, tmp_path):
    """The left camera is off by 50 mm before and by 10 mm after, at two steps; elsewhere nothing was adjusted."""
    run = truthful_run(toy_recording)
    before = moved(run, LEFT, [0, 0, 0, 0.03, 0.04, 0])
    after = moved(run, LEFT, [0, 0, 0, 0.006, 0.008, 0])
    steps = tuple(
        replace(step, adjustment=AdjustmentResult(old.cameras, old.objects, (3.5, 1.5), {RIGHT: "it strayed"}))
        if number in (0, 2)
        else step
        for number, (old, step) in enumerate(zip(before.steps, after.steps, strict=True))
    )
    write_run(tmp_path / "results.json", replace(after, steps=steps))
    read = read_run(tmp_path / "results.json")
    assert read.steps[2].adjustment.kept == {RIGHT: "it strayed"} and read.steps[2].adjustment.energy == (3.5, 1.5)
    errors = judge(read, toy_recording).adjustment
    # A camera counts where it was measured, which a perfect run's are at the first step alone.
    assert [len(pairs) for pairs in errors.cameras.values()] == [1, 1]
    rows = {row[0]: row[1:] for row in adjustment_table(errors).rows}
    assert rows[LEFT] == pytest.approx((1, 50, 10, 0, 0, 100, 0), abs=1e-3)
    # Two of six steps were adjusted; a perfect run has every object, before and after.
    assert rows["objects, ADD(-S)"][:3] == pytest.approx((len(errors.objects), 0, 0), abs=1e-3)
    assert len(errors.objects) == sum(len(found) for found in judge(read, toy_recording).objects.values()) / 3
    assert judge(run, toy_recording).adjustment is None


def test_drift_of_the_headset_counts_as_error_of_what_it_looks_at(toy_recording):
    errors = judge(moved(truthful_run(toy_recording), HEADSET, [0, 0, 0, 0.02, 0, 0]), toy_recording)
    assert errors.cameras[LEFT][0].centre_mm == pytest.approx(20, abs=0.1)
    assert errors.pairs[LEFT, RIGHT][0].centre_mm < 1e-6
    assert min(min(found) for found in errors.objects.values()) == pytest.approx(0.02, rel=0.5)


def test_the_headset_is_judged_as_corrected_and_by_its_tracking_alone(toy_recording):
    run = truthful_run(toy_recording)
    drift = se3.exp(np.array([0, 0, 0.02, 0, 0, 0]))
    steps = tuple(
        replace(step, world_from_tracking=np.eye(4) if number < 3 else drift) for number, step in enumerate(run.steps)
    )
    errors = judge(replace(run, steps=steps), toy_recording)
    assert all(e.centre_mm < 1e-6 for e in errors.headset)
    assert [e.rotation_deg > 1 for e in errors.tracking] == [False] * 3 + [True] * 3
    assert errors.tracking[4].rotation_deg == pytest.approx(np.degrees(0.02))
    rows = {row["camera"]: row for row in camera_table(run, errors).to_plain()["rows"]}
    assert rows[f"{HEADSET} by its tracking alone"]["last deg"] == pytest.approx(np.degrees(0.02))
    assert rows[f"{HEADSET} since its first pose"]["last deg"] == pytest.approx(0, abs=1e-5)
    assert rows[f"{HEADSET} since its first pose"]["inside 95 %"] is None


def test_the_whole_world_may_be_elsewhere(toy_recording, rng):
    shift = se3.random(rng)
    run = truthful_run(toy_recording)
    steps = tuple(
        replace(
            step,
            cameras=tuple(replace(c, world_from_camera=shift @ c.world_from_camera) for c in step.cameras),
            objects=tuple(replace(o, world_from_object=shift @ o.world_from_object) for o in step.objects),
        )
        for step in run.steps
    )
    errors = judge(replace(run, steps=steps), toy_recording)
    assert all(e.centre_mm < 1e-6 for series in errors.cameras.values() for e in series)
    assert all(max(found) < 1e-6 for found in errors.objects.values())


def test_steps_without_a_pose_are_counted_and_not_averaged_away(toy_recording):
    run = truthful_run(toy_recording, placed_from=2)
    errors = judge(run, toy_recording)
    assert errors.cameras[LEFT][:2] == (None, None)
    table = camera_table(run, errors).to_plain()["rows"]
    assert table[0]["camera"] == f"{LEFT} in {HEADSET}"
    assert table[0]["has pose %"] == pytest.approx(100 * 4 / 6)
    assert table[0]["good %"] == pytest.approx(100 * 4 / 6)
    coverage = {row["camera"]: row for row in coverage_table(run).to_plain()["rows"]}
    assert coverage[LEFT] == {
        "camera": LEFT, "has pose %": pytest.approx(100 * 4 / 6), "measured": 1, "kept": 3, "not placed": 2,
        "first pose s": pytest.approx(4.0),
    }  # fmt: skip
    assert coverage[HEADSET]["measured"] == 6


def test_missing_objects_are_infinite_errors(toy_recording):
    run = truthful_run(toy_recording)
    without = replace(run, steps=tuple(replace(s, objects=()) for s in run.steps))
    errors = judge(without, toy_recording)
    assert all(np.isinf(found).all() for found in errors.objects.values())
    rows = object_table(errors, toy_recording.catalogue).to_plain()["rows"]
    assert rows[-1]["object"] == "mean of classes"
    assert rows[-1]["within 0.1 d %"] == 0


def test_a_network_that_finds_nothing_is_called_weak(toy_recording):
    run = truthful_run(toy_recording)
    errors = evaluate_run(run, {}, toy_recording, SilentProgress())
    facts, warnings = statements(run, errors, toy_recording.catalogue)
    assert any(text.startswith("The network is weak") for text in warnings)
    assert any("0 % of what the network is shown in single pictures; 100 % of what any" in text for text in facts)


def test_a_run_without_a_single_placed_camera_says_so(toy_recording):
    run = truthful_run(toy_recording, placed_from=5)
    never = replace(
        run,
        steps=tuple(
            replace(
                s,
                cameras=tuple(
                    c if c.camera_id == HEADSET
                    else replace(c, status="not placed", world_from_camera=None, covariance=None, updated_ns=None)
                    for c in s.cameras
                ),
            )
            for s in run.steps
        ),
    )  # fmt: skip
    errors = judge(never, toy_recording)
    rows = camera_table(never, errors).to_plain()["rows"]
    assert [row["has pose %"] for row in rows[:3]] == [0, 0, 0]
    assert rows[0]["median mm"] is None
    facts, warnings = statements(never, errors, toy_recording.catalogue)
    assert facts[0] == "0 of 2 static cameras were placed in 6 steps."
    assert f"Camera {LEFT} was never placed." in warnings


def test_poor_cameras_and_small_ellipsoids_are_warned_of(toy_recording):
    run = moved(truthful_run(toy_recording), LEFT, [0, 0, 0, 0.2, 0, 0])
    run = moved(run, RIGHT, [0, 0, 0, 0.2, 0, 0])
    _, warnings = statements(run, judge(run, toy_recording), toy_recording.catalogue)
    assert any(text.startswith("Camera poses are poor") for text in warnings)
    assert any(text.startswith("The stated uncertainties are too small: 0 %") for text in warnings)


def test_times_are_split_by_stage(toy_recording):
    rows = {r["stage"]: r["median ms"] for r in time_table(truthful_run(toy_recording)).to_plain()["rows"]}
    assert rows == pytest.approx({"network": 20, "pnp": 1, "graph": 5, "all": 26})


def test_a_run_of_another_recording_is_refused(toy_recording):
    run = truthful_run(toy_recording)
    shifted = replace(
        run,
        steps=tuple(
            replace(s, cameras=tuple(replace(c, timestamp_ns=c.timestamp_ns + 1) for c in s.cameras))
            for s in run.steps
        ),
    )  # fmt: skip
    with pytest.raises(DataError, match="was the run made on another recording"):
        judge(shifted, toy_recording)


def test_results_survive_the_disk(toy_recording, tmp_path):
    run = truthful_run(toy_recording, placed_from=1)
    write_run(tmp_path / "results.json", run)
    found = read_run(tmp_path / "results.json")
    assert found.recording == run.recording
    assert [s.seconds for s in found.steps] == [s.seconds for s in run.steps]
    for step, other in zip(found.steps, run.steps, strict=True):
        for a, b in zip(step.cameras, other.cameras, strict=True):
            assert (a.camera_id, a.status, a.reason, a.chain, a.updated_ns) == (
                b.camera_id, b.status, b.reason, b.chain, b.updated_ns,
            )  # fmt: skip
            assert (a.world_from_camera is None) == (b.world_from_camera is None)
            if a.world_from_camera is not None:
                np.testing.assert_array_equal(a.world_from_camera, b.world_from_camera)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda d: d.update(version=7), "is not the result of a run"),
        (lambda d: d.update(steps=[]), "holds no steps"),
        (lambda d: d.update(extra=1), "extra"),
        (lambda d: d["steps"][0]["cameras"][0].update(world_from_camera=[[1, 2]]), "4x4 or 6x6"),
        (lambda d: d["steps"][0]["cameras"][0].update(status="lost"), "status"),
    ],
)
def test_malformed_results_are_refused_in_one_sentence(toy_recording, tmp_path, change, sentence):
    import json

    path = tmp_path / "results.json"
    write_run(path, truthful_run(toy_recording))
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(DataError, match=sentence) as raised:
        read_run(path)
    assert "\n" not in str(raised.value)


def test_a_bumped_camera_is_judged_where_it_stands_at_each_step(tmp_path):
    recording = write_toy_recording(tmp_path)
    scene = next(c.scene_id for c in recording.cameras if c.camera_id == LEFT)
    bump = se3.exp(np.array([0, 0, 0.1, 0.03, 0.04, 0]))

    def knock(table):
        for number in ("3", "4", "5"):
            row = table[number]
            pose = transform_from_bop(row["cam_R_w2c"], row["cam_t_w2c"])
            row |= pose_row(se3.inverse(bump) @ pose, "w2c")

    still = truthful_run(recording)
    edit_json(tmp_path / "test" / f"{scene:06d}" / "scene_camera.json", knock)
    bumped = load_recording(tmp_path)
    errors = judge(still, bumped)
    # A run that has not noticed is right before and wrong after; one that has is right throughout.
    assert [e.centre_mm > 1 for e in errors.cameras[LEFT]] == [False] * 3 + [True] * 3
    assert [e.centre_mm > 1 for e in errors.pairs[LEFT, RIGHT]] == [False] * 3 + [True] * 3
    assert errors.cameras[LEFT][4].rotation_deg == pytest.approx(np.degrees(0.1))
    noticed = judge(truthful_run(bumped), bumped)
    assert all(e.centre_mm < 1e-6 for e in noticed.cameras[LEFT])
    # Without a picture at a step, the camera is where its latest one was taken.
    steps = tuple(
        replace(step, cameras=tuple(replace(c, timestamp_ns=None) if c.camera_id == LEFT else c for c in step.cameras))
        for step in truthful_run(bumped).steps
    )
    assert all(e.centre_mm < 1e-6 for e in judge(replace(still, steps=steps), bumped).cameras[LEFT])
