"""Files are whole or absent, and faults name their file."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from multicam.errors import DataError, describe, did_you_mean
from multicam.files import read_json, require_file, require_folder, write_atomic, write_bytes, write_json, write_text
from tests.faults import sentence


def test_a_write_replaces_the_old_content_and_leaves_no_other_file(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "file.bin"
    write_bytes(path, b"old")
    write_bytes(path, b"new")
    assert path.read_bytes() == b"new"
    assert [p.name for p in path.parent.iterdir()] == ["file.bin"]


def test_a_block_that_fails_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    write_text(path, "old")

    def fail_halfway() -> None:
        with write_atomic(path) as temporary:
            temporary.write_text("half of the new")
            raise RuntimeError("halfway")

    with pytest.raises(RuntimeError, match="halfway"):
        fail_halfway()
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["file.txt"]


def test_the_new_file_is_not_seen_before_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    with write_atomic(path) as temporary:
        temporary.write_text("new")
        assert not path.exists()
        assert temporary.parent == tmp_path
        # Writers choose the format by the suffix; listings skip hidden files.
        assert temporary.suffix == ".txt"
        assert temporary.name.startswith(".")
    assert path.read_text() == "new"


def test_a_killed_writer_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    write_text(path, "old")
    script = (
        "import os, signal, sys; from pathlib import Path; from multicam.files import write_atomic\n"
        "with write_atomic(Path(sys.argv[1])) as t:\n t.write_text('half'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", script, str(path)], check=False)
    assert done.returncode == -9
    assert path.read_text() == "old"


@pytest.mark.parametrize("umask", [0o022, 0o027, 0o077])
def test_files_get_the_permissions_of_any_new_file(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        write_text(tmp_path / "file.txt", "text")
        assert os.umask(umask) == umask
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "file.txt").stat().st_mode) == 0o666 & ~umask


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(json_values, st.sampled_from([None, 1]))
def test_json_comes_back_as_it_was_written(
    tmp_path_factory: pytest.TempPathFactory, value: Any, indent: int | None
) -> None:
    path = tmp_path_factory.getbasetemp() / "value.json"
    write_json(path, value, indent)
    assert read_json(path) == value


@pytest.mark.parametrize("value", [float("nan"), float("inf"), {"a": [1.0, float("-inf")]}])
def test_numbers_that_json_does_not_know_are_not_written(tmp_path: Path, value: Any) -> None:
    path = tmp_path / "value.json"
    write_json(path, "old")
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, value)
    assert read_json(path) == "old"


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b'{"a": 1,}', "is not valid JSON: Expecting property name enclosed in double quotes at line 1, column 9."),
        (b'{\n"a": [1, 2\n', "is not valid JSON: Expecting ',' delimiter at line 3, column 1."),
        (b"", "is not valid JSON: Expecting value at line 1, column 1."),
        (b'"caf\xe9"', "is not a text file: byte 4 is not UTF-8."),
    ],
)
def test_malformed_json_is_refused_where_it_breaks(tmp_path: Path, content: bytes, expected: str) -> None:
    path = tmp_path / "broken.json"
    path.write_bytes(content)
    assert sentence(lambda: read_json(path)) == f"{path} {expected}"


def test_missing_files_and_folders_are_refused_with_the_nearest_that_exists(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "c.json"
    nearest = f"does not exist; the nearest existing folder is {tmp_path}."
    assert sentence(lambda: require_file(path)) == f"The file {path} {nearest}"
    assert sentence(lambda: require_file(path, "mesh file")) == f"The mesh file {path} {nearest}"
    assert sentence(lambda: require_folder(path, "models folder")) == f"The models folder {path} {nearest}"
    assert sentence(lambda: read_json(path)) == f"The file {path} {nearest}"


def test_a_file_is_no_folder_and_a_folder_no_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("")
    assert (
        sentence(lambda: require_file(tmp_path, "mesh file"))
        == f"{tmp_path} is a folder where a mesh file was expected."
    )
    assert sentence(lambda: require_folder(path)) == f"{path} is a file where a folder was expected."
    assert require_file(path) == path
    assert require_folder(tmp_path) == tmp_path


def test_suggestions_name_what_is_close_and_keep_silent_otherwise() -> None:
    assert did_you_mean("widht", ["height", "width"]) == ' (did you mean "width"?)'
    assert did_you_mean("zzz", ["height", "width"]) == ""
    assert did_you_mean("x", []) == ""


def test_errors_of_readers_become_ends_of_sentences() -> None:
    assert describe(KeyError("cam_K")) == '"cam_K" is missing'
    assert describe(ValueError("pose holds NaN")) == "pose holds NaN"
    assert issubclass(DataError, Exception)
