"""BOP result files: there and back, and faults named by their line."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from multicam.dataset.results import read_results, write_results
from multicam.types import ObjectEstimate
from tests.close import assert_close
from tests.faults import sentence
from tests.strategies import transforms

HEADER = "scene_id,im_id,obj_id,score,R,t,time\n"
ROW = "1,2,3,0.5,1 0 0 0 1 0 0 0 1,10 20 900,0.1\n"


@st.composite
def rows(draw: st.DrawFn) -> tuple[int, int, ObjectEstimate, float]:
    ids = st.integers(0, 10**6)
    estimate = ObjectEstimate(draw(ids), draw(st.floats(0, 1)), draw(transforms()))
    return draw(ids), draw(ids), estimate, draw(st.sampled_from([-1.0, 0.25]))


@given(st.lists(rows(), max_size=5))
def test_estimates_come_back_as_they_were_written(
    tmp_path_factory: pytest.TempPathFactory, written: list[tuple[int, int, ObjectEstimate, float]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "results.csv"
    write_results(path, written)
    found = read_results(path)
    assert set(found) == {(scene, image) for scene, image, _, _ in written}
    for key, estimates in found.items():
        expected = [e for scene, image, e, _ in written if (scene, image) == key]
        for a, b in zip(estimates, expected, strict=True):
            assert (a.obj_id, a.score) == (b.obj_id, pytest.approx(b.score, abs=1e-6))
            assert_close(a.camera_from_object, b.camera_from_object, atol=2e-9)


@given(st.lists(st.tuples(rows(), st.none() | st.integers(0, 1000)), max_size=5))
def test_covariances_come_back_where_they_are_asked_for(
    tmp_path_factory: pytest.TempPathFactory,
    written: list[tuple[tuple[int, int, ObjectEstimate, float], int | None]],
) -> None:
    stated: list[tuple[int, int, ObjectEstimate, float]] = []
    for (scene, image, estimate, seconds), seed in written:
        covariance = None
        if seed is not None:
            root = np.random.default_rng(seed).normal(size=(6, 6)) * np.repeat([0.03, 0.005], 3)[:, None]
            covariance = root @ root.T
        stated.append((scene, image, replace(estimate, covariance=covariance), seconds))
    folder = tmp_path_factory.getbasetemp()
    write_results(folder / "uncertain.csv", stated, covariances=True)
    write_results(folder / "plain.csv", stated)
    assert all(e.covariance is None for found in read_results(folder / "plain.csv").values() for e in found)
    for key, estimates in read_results(folder / "uncertain.csv").items():
        expected = [e for scene, image, e, _ in stated if (scene, image) == key]
        for a, b in zip(estimates, expected, strict=True):
            assert_close(a.camera_from_object, b.camera_from_object, atol=2e-9)
            assert (a.covariance is None) == (b.covariance is None)
            if a.covariance is not None and b.covariance is not None:
                assert_close(a.covariance, b.covariance, atol=1e-10)


def test_a_covariance_reads_in_radians_and_millimetres(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    numbers = np.zeros((6, 6))
    numbers[0, 0], numbers[0, 5], numbers[5, 5] = 0.04, 0.3, 9.0
    upper = " ".join(str(v) for v in numbers[np.triu_indices(6)])
    path.write_text(f"{HEADER.strip()},covariance\n{ROW.strip()},{upper}\n")
    (estimate,) = read_results(path)[1, 2]
    assert estimate.covariance is not None
    assert (estimate.covariance[0, 0], estimate.covariance[5, 5]) == (pytest.approx(0.04), pytest.approx(9e-6))
    assert estimate.covariance[0, 5] == estimate.covariance[5, 0] == pytest.approx(3e-4)


@pytest.mark.parametrize(
    ("column", "expected"),
    [
        (",1 2 3", "a covariance has 21 finite numbers, got '1 2 3'"),
        ("," + "nan " * 21, "a covariance has 21 finite numbers"),
        ("", "8 columns are needed, got 7"),
    ],
)
def test_a_faulty_covariance_is_refused_with_its_line(tmp_path: Path, column: str, expected: str) -> None:
    path = tmp_path / "results.csv"
    path.write_text(f"{HEADER.strip()},covariance\n{ROW.strip()},\n{ROW.strip()}{column}\n")
    text = sentence(lambda: read_results(path))
    assert text.startswith(f"{path}, line 3: ")
    assert expected in text


def test_a_row_reads_as_the_format_says(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    path.write_text(HEADER + ROW + "\n" + ROW.replace("0.5", "0.25"))
    first, second = read_results(path)[1, 2]
    assert (first.obj_id, first.score, second.score) == (3, 0.5, 0.25)
    assert_close(first.camera_from_object[:3, 3], [0.01, 0.02, 0.9])


def test_gzipped_files_are_read(tmp_path: Path) -> None:
    path = tmp_path / "results.csv.gz"
    path.write_bytes(gzip.compress((HEADER + ROW).encode()))
    assert list(read_results(path)) == [(1, 2)]


def test_a_file_without_rows_holds_no_estimates(tmp_path: Path) -> None:
    write_results(tmp_path / "empty.csv", [])
    assert (tmp_path / "empty.csv").read_text() == HEADER
    assert read_results(tmp_path / "empty.csv") == {}


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        (ROW.replace("10 20 900", "10 nan 900"), "pose holds NaN or infinity"),
        (ROW.replace("1 0 0 0 1 0 0 0 1", "1 0 0 0 1 0 0 0 inf"), "pose holds NaN or infinity"),
        (ROW.replace("1 0 0 0 1 0 0 0 1", "1 0 0 0 1 0 0 0"), "9 rotation and 3 translation numbers, got 8 and 3"),
        (ROW.replace("10 20 900", "10 20"), "9 rotation and 3 translation numbers, got 9 and 2"),
        (ROW.replace("1 0 0 0 1 0 0 0 1", "1 0 0 0 1 0 0 0 -1"), "not orthonormal, or mirrors"),
        (ROW.replace("1 0 0 0 1 0 0 0 1", "9 0 0 0 9 0 0 0 9"), "not orthonormal"),
        (ROW.replace("0.5", "nan"), "score is not finite"),
        (ROW.replace("0.5", "high"), "could not convert string to float: 'high'"),
        (ROW.replace("1,2,3", "1,2,screw"), "'screw'"),
        (ROW.replace(",0.1", ""), "7 columns are needed, got 6"),
        (ROW.replace(",0.1", ",0.1,9"), "7 columns are needed, got 8"),
    ],
)
def test_a_faulty_row_is_refused_with_its_line(tmp_path: Path, row: str, expected: str) -> None:
    path = tmp_path / "results.csv"
    path.write_text(HEADER + ROW + "\n" + row + ROW)
    text = sentence(lambda: read_results(path))
    assert text.startswith(f"{path}, line 4: ")
    assert expected in text


@pytest.mark.parametrize("content", ["", "image,pose\n1,2\n", ROW, '{"scene_id": 1}'])
def test_a_wrong_header_is_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "results.csv"
    path.write_text(content)
    assert "a BOP results file starts with 'scene_id,im_id,obj_id,score,R,t,time'" in sentence(
        lambda: read_results(path)
    )


def broken_gzip() -> bytes:
    data = bytearray(gzip.compress((HEADER + ROW * 50).encode()))
    data[10] = 0xFF
    return bytes(data)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("results.csv", b"scene_id\xff\xfe"),
        ("results.csv.gz", (HEADER + ROW).encode()),
        ("results.csv.gz", gzip.compress((HEADER + ROW * 50).encode())[:-12]),
        ("results.csv.gz", broken_gzip()),
        ("results.csv.gz", b""),
        ("results.csv", HEADER.encode() + b'"' + b"1" * 200_000),
    ],
    ids=["no text", "not gzipped", "truncated", "corrupt", "empty", "endless field"],
)
def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    text = sentence(lambda: read_results(path))
    assert str(path) in text


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    assert "results file" in sentence(lambda: read_results(tmp_path / "absent.csv"))


def test_published_estimates_are_read(bench_dir: Path) -> None:
    path = next((bench_dir / "tless" / "results").iterdir())
    estimates = read_results(path)
    assert len(estimates) > 100
    distance = [e.camera_from_object[2, 3] for found in estimates.values() for e in found]
    assert 0.3 < np.median(distance) < 1.5
