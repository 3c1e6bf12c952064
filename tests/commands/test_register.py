"""The command on a toy data set: its files, its sentences for bad input, and the real data where they are."""

from __future__ import annotations

import importlib.util
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from multicam.cli import run
from multicam.commands.register import RegisterConfig, register_groups
from multicam.config import load_config
from multicam.dataset.results import read_results, write_results
from multicam.errors import DataError
from multicam.geometry import se3
from multicam.matching.learned import NoiseModel
from multicam.progress import SilentProgress
from tests.bundle.scenery.room import CAMERA, draw, standing
from tests.toy_objects import BRACKET, toy_catalogue
from tests.toy_world import ToyCamera, ToyWorld, make_world, place_objects

SCENE = 3
IM_IDS = (10, 11, 12, 13)
BLIND = 99
"""An image of the data set in which nothing was found."""


@pytest.fixture
def world(rng: np.random.Generator) -> ToyWorld:
    return make_world(rng, num_cameras=4)


@pytest.fixture
def dataset(tmp_path: Path, world: ToyWorld, rng: np.random.Generator) -> Path:
    """A BOP folder without images and without any ground truth, its estimates and its groups."""
    folder = tmp_path / "dataset"
    write(folder / "models" / "models_info.json", models_info())
    cameras = {
        str(i): {"cam_K": c.camera.matrix.reshape(-1).tolist()}
        for i, c in zip((*IM_IDS, BLIND), (*world.cameras, world.cameras[0]), strict=True)
    }
    write(folder / "test" / f"{SCENE:06d}" / "scene_camera.json", cameras)
    views = world.views(rng, rotation_noise=0.01, translation_noise=0.002)
    rows = [(SCENE, i, e, -1.0) for i, view in zip(IM_IDS, views, strict=True) for e in view.estimates]
    write_results(tmp_path / "results.csv", rows)
    write_groups(tmp_path, [list(IM_IDS[:3]), list(IM_IDS), [IM_IDS[0], BLIND]])
    return folder


def write(path: Path, value: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value))


def write_groups(folder: Path, groups: list[list[int]]) -> None:
    rows = [{"group_id": n, "scene_id": SCENE, "im_ids": im_ids} for n, im_ids in enumerate(groups)]
    write(folder / "groups.json", {"n_views": 3, "seed": 0, "groups": rows})


def models_info() -> dict[str, Any]:
    info: dict[str, Any] = {}
    for model in toy_catalogue().objects.values():
        assert model.box is not None
        low, size = 1000 * model.box[0], 1000 * (model.box[1] - model.box[0])
        discrete = model.symmetries.discrete.copy()
        discrete[:, :3, 3] *= 1000
        info[str(model.obj_id)] = {
            "name": model.name,
            "diameter": 1000 * model.diameter,
            **{f"min_{axis}": low[i] for i, axis in enumerate("xyz")},
            **{f"size_{axis}": size[i] for i, axis in enumerate("xyz")},
            "symmetries_discrete": discrete.reshape(-1, 16).tolist(),
            "symmetries_continuous": [
                {"axis": a.direction.tolist(), "offset": (1000 * a.offset).tolist()} for a in model.symmetries.axes
            ],
        }
    return info


def arguments(dataset: Path, *more: str) -> list[str]:
    folder = dataset.parent
    return [
        "register", "--dataset", str(dataset), "--candidates", str(folder / "results.csv"),
        "--groups", str(folder / "groups.json"), "--output", str(folder / "out" / "predictions.json"),
        "--workers", "1", *more,
    ]  # fmt: skip


def predictions(dataset: Path) -> list[dict[str, Any]]:
    return json.loads((dataset.parent / "out" / "predictions.json").read_text())["groups"]


def answers(dataset: Path) -> list[dict[str, Any]]:
    """The predictions without what differs from run to run."""
    return [{key: value for key, value in group.items() if key != "seconds"} for group in predictions(dataset)]


def refused(capsys: pytest.CaptureFixture[str], dataset: Path, *more: str) -> str:
    """Runs the command on bad input; one sentence, exit code 2, nothing written."""
    assert run(arguments(dataset, *more)) == 2
    error = capsys.readouterr().err.strip()
    assert "Traceback" not in error
    assert error.startswith("multicam register: ")
    assert len(error.splitlines()) == 1
    out = dataset.parent / "out"
    assert not out.exists() or not list(out.iterdir())
    return error


def test_every_group_is_answered_in_the_scorers_format(dataset: Path, world: ToyWorld) -> None:
    assert run(arguments(dataset)) == 0
    groups = predictions(dataset)
    assert [group["group_id"] for group in groups] == [0, 1, 2]
    assert all(group["seconds"] > 0 for group in groups)
    component = groups[1]["components"][0]
    assert [camera["im_id"] for camera in component["cameras"]] == list(IM_IDS)
    poses = np.array([camera["world_from_camera"] for camera in component["cameras"]])
    truth = np.array([camera.world_from_camera for camera in world.cameras])
    assert np.allclose(poses[0], np.eye(4))
    error = np.linalg.norm(poses[:, :3, 3] - (se3.inverse(truth[0]) @ truth)[:, :3, 3], axis=1)
    assert error.max() < 0.03
    assert np.array(component["cameras"][1]["covariance"]).shape == (6, 6)
    assert len(component["objects"]) == len(world.objects)
    assert component["objects"][0]["seen_in"] == list(IM_IDS)


def test_an_image_without_estimates_is_refused_in_words(dataset: Path) -> None:
    assert run(arguments(dataset)) == 0
    last = predictions(dataset)[2]
    assert last["components"] == []
    assert "no known object" in last["refusals"]["99"]
    assert set(last["refusals"]) == {"10", "99"}


def test_the_configuration_is_saved_and_read_back(dataset: Path) -> None:
    assert run(arguments(dataset, "--registration.noise.pixel-std", "3.5")) == 0
    saved = load_config(RegisterConfig, dataset.parent / "out" / "predictions.config.yaml")
    assert saved.registration.noise.pixel_std == 3.5
    assert saved.dataset == dataset


def test_learnt_noise_is_written_and_used_again(dataset: Path) -> None:
    assert run(arguments(dataset)) == 0
    first, noise = answers(dataset), dataset.parent / "out" / "predictions.noise.yaml"
    assert load_config(NoiseModel, noise).classes
    kept = dataset.parent / "kept.yaml"
    noise.rename(kept)
    assert run(arguments(dataset, "--noise", str(kept))) == 0
    assert answers(dataset) == first
    assert run(arguments(dataset, "--learning.rounds", "0")) == 0
    assert load_config(NoiseModel, noise) == NoiseModel()
    assert answers(dataset) != first


def test_a_noise_file_that_is_none_is_refused(dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = dataset.parent / "bad.yaml"
    bad.write_text("kinship: 0.2\n")
    assert "kinship must be at least 1" in refused(capsys, dataset, "--noise", str(bad))
    assert "noise file" in refused(capsys, dataset, "--noise", str(dataset / "none.yaml"))


def test_the_number_of_processes_does_not_change_the_answer(dataset: Path) -> None:
    found: list[list[dict[str, Any]]] = []
    for workers in (1, 2):
        folder = dataset.parent
        output = folder / "out" / "predictions.json"
        config = RegisterConfig(dataset, folder / "results.csv", folder / "groups.json", output, workers=workers)
        summary = register_groups(config, SilentProgress())
        assert "3 groups answered; 7 of 9 views placed" in summary
        found.append(answers(dataset))
    assert found[0] == found[1]


def test_a_data_set_without_cameras_uses_the_assumed_focal_length(dataset: Path) -> None:
    (dataset / "test" / f"{SCENE:06d}" / "scene_camera.json").unlink()
    assert run(arguments(dataset)) == 0
    assert len(predictions(dataset)[0]["components"][0]["cameras"]) == 3


@pytest.mark.parametrize("name", ["results.csv", "groups.json", "dataset"])
def test_a_missing_file_is_named(dataset: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    (dataset.parent / name).rename(dataset.parent / "elsewhere")
    assert name in refused(capsys, dataset)


def test_an_unknown_class_is_named(dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replace_in(dataset.parent / "results.csv", f"{SCENE},12,", ",1,", ",77,")
    message = refused(capsys, dataset)
    assert "class 77 (scene 3, image 12)" in message
    assert "1, 2, 3, 4, 5, 6" in message


def test_a_pose_that_is_no_number_is_named(dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (dataset.parent / "results.csv").read_text().splitlines()
    columns = text[4].split(",")
    columns[5] = "nan 0 900"
    text[4] = ",".join(columns)
    (dataset.parent / "results.csv").write_text("\n".join(text))
    assert "line 5" in refused(capsys, dataset)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('{"groups": [', "not valid JSON"),
        ("[]", '{"groups": [...]}'),
        ('{"groups": []}', "at least one group"),
        ('{"groups": [{"group_id": 0}]}', "entry 0"),
        ('{"groups": [{"group_id": 0, "scene_id": 3, "im_ids": "10"}]}', "whole numbers"),
        ('{"groups": [{"group_id": 0, "scene_id": 3, "im_ids": [10.5, 11]}]}', "whole numbers"),
        ('{"groups": [{"group_id": 4, "scene_id": 3, "im_ids": []}]}', "group 4"),
        ('{"groups": [{"group_id": 4, "scene_id": 3, "im_ids": [10]}]}', "holds one image; at least two views"),
        ('{"groups": [{"group_id": 4, "scene_id": 3, "im_ids": [10, 10]}]}', "twice"),
        (
            '{"groups": [{"group_id": 1, "scene_id": 3, "im_ids": [10, 11]}, '
            '{"group_id": 1, "scene_id": 3, "im_ids": [11, 12]}]}',
            "two groups with group_id 1",
        ),
    ],
)
def test_groups_that_cannot_be_answered_are_refused(
    dataset: Path, capsys: pytest.CaptureFixture[str], text: str, expected: str
) -> None:
    (dataset.parent / "groups.json").write_text(text)
    assert expected in refused(capsys, dataset)


def test_a_malformed_camera_file_is_named(dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(dataset / "test" / f"{SCENE:06d}" / "scene_camera.json", {"10": {"cam_K": [1, 2, 3]}})
    assert "image 10" in refused(capsys, dataset)


def test_models_in_metres_are_refused(dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    info = models_info()
    info["1"]["diameter"] /= 1000
    write(dataset / "models" / "models_info.json", info)
    assert "millimetres" in refused(capsys, dataset)


def test_estimates_in_metres_are_refused(dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = dataset.parent / "results.csv"
    rows = [
        (
            scene,
            image,
            replace(
                e, camera_from_object=se3.from_parts(e.camera_from_object[:3, :3], e.camera_from_object[:3, 3] / 1000)
            ),
            -1.0,
        )
        for (scene, image), found in read_results(path).items()
        for e in found
    ]
    write_results(path, rows)
    assert "are they in metres?" in refused(capsys, dataset)


def test_a_group_of_an_unknown_scene_is_refused(dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(dataset.parent / "groups.json", {"groups": [{"group_id": 5, "scene_id": 44, "im_ids": [1, 2]}]})
    assert "group 5 names image 1 of scene 44" in refused(capsys, dataset)


def test_a_group_of_an_unknown_image_is_refused(dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_groups(dataset.parent, [[IM_IDS[0], 98]])
    assert "group 0 names image 98 of scene" in refused(capsys, dataset)


def test_results_without_an_estimate_are_refused(dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_results(dataset.parent / "results.csv", [])
    assert "no estimate" in refused(capsys, dataset)


def test_a_negative_number_of_workers_is_refused(dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "workers" in refused(capsys, dataset, "--workers", "-1")


def test_an_old_answer_survives_a_failure(dataset: Path) -> None:
    assert run(arguments(dataset)) == 0
    before = predictions(dataset)
    replace_in(dataset.parent / "results.csv", f"{SCENE},12,", ",1,", ",77,")
    assert run(arguments(dataset)) == 2
    assert predictions(dataset) == before


@pytest.mark.parametrize(
    ("name", "method", "views"), [("lmo", "megapose_lmo-test", 3), ("tless", "megapose_tless-test", 4)]
)
def test_every_real_group_is_answered(bench_dir: Path, tmp_path: Path, name: str, method: str, views: int) -> None:
    groups = json.loads((bench_dir / name / f"groups_{views}.json").read_text())
    groups["groups"] = groups["groups"][:12]
    write(tmp_path / "groups.json", groups)
    output = tmp_path / "predictions.json"
    candidates = bench_dir / name / "results" / f"{method}.csv.gz"
    register_groups(RegisterConfig(bench_dir / name, candidates, tmp_path / "groups.json", output), SilentProgress())
    figures = score(bench_dir, name, groups, json.loads(output.read_text()))
    assert figures["groups"] == 12
    assert figures["placed"] > 30


def test_ycbv_estimates_give_cameras_within_two_centimetres(bench_dir: Path, tmp_path: Path) -> None:
    groups = json.loads((bench_dir / "ycbv" / "groups_3.json").read_text())
    groups["groups"] = groups["groups"][::40]
    write(tmp_path / "groups.json", groups)
    output = tmp_path / "predictions.json"
    candidates = bench_dir / "ycbv" / "results" / "cosypose_ycbv-test.csv.gz"
    register_groups(RegisterConfig(bench_dir / "ycbv", candidates, tmp_path / "groups.json", output), SilentProgress())
    figures = score(bench_dir, "ycbv", groups, json.loads(output.read_text()))
    assert figures["placed"] >= 98
    assert figures["mean_t"] < 20
    assert figures["mean_r"] < 1.4
    assert figures["false"] < 1


def score(bench_dir: Path, name: str, groups: dict[str, Any], found: dict[str, Any]) -> dict[str, float]:
    """Figures of the neutral scorer that comes with the data; cameras only."""
    spec = importlib.util.spec_from_file_location("score", bench_dir / "score.py")
    assert spec is not None
    assert spec.loader is not None
    scorer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scorer)
    truth = scorer.Truth(bench_dir / name)
    truth.points = {}
    return scorer.score(truth, groups, found)


def replace_in(path: Path, line_start: str, old: str, new: str) -> None:
    """Replaces `old` in the first line that starts so and holds it."""
    lines = path.read_text().splitlines()
    index = next(i for i, line in enumerate(lines) if line.startswith(line_start) and old in line)
    lines[index] = lines[index].replace(old, new, 1)
    path.write_text("\n".join(lines) + "\n")


def test_with_pictures_one_object_places_a_camera(tmp_path: Path, rng: np.random.Generator) -> None:
    cameras = tuple(
        ToyCamera(str(i), standing(angle), (0,), CAMERA) for i, angle in zip((4, 7), (-0.2, 0.1), strict=True)
    )
    world = ToyWorld(toy_catalogue(), cameras, place_objects(rng, (BRACKET,)))
    folder, scene = tmp_path / "dataset", tmp_path / "dataset" / "test" / f"{SCENE:06d}"
    write(folder / "models" / "models_info.json", models_info())
    write(scene / "scene_camera.json", {c.camera_id: {"cam_K": CAMERA.matrix.reshape(-1).tolist()} for c in cameras})
    views = world.views(rng, rotation_noise=0.02, translation_noise=0.005)
    write_results(tmp_path / "results.csv", [(SCENE, int(v.view_id), e, -1.0) for v in views for e in v.estimates])
    write_groups(tmp_path, [[4, 7]])
    (scene / "rgb").mkdir()
    config = RegisterConfig(
        folder, tmp_path / "results.csv", tmp_path / "groups.json", tmp_path / "out.json", workers=1
    )
    with pytest.raises(DataError, match="no picture in rgb/ or gray/ for image 4; without --pictures none is needed"):
        register_groups(replace(config, pictures=True), SilentProgress())
    for camera in cameras:
        picture = draw(camera.world_from_camera)[..., ::-1]
        assert cv2.imwrite(str(scene / "rgb" / f"{int(camera.camera_id):06d}.png"), picture)
    placed = []
    for pictures in (False, True):
        register_groups(replace(config, pictures=pictures), SilentProgress())
        (answer,) = json.loads((tmp_path / "out.json").read_text())["groups"]
        placed.append(sum(len(component["cameras"]) for component in answer["components"]))
    assert placed == [0, 2]
