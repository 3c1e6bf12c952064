"""Reading and writing files without torn results: every write is a rename, every read names its file.

A process killed at any moment leaves each file as it was or as it was to become, and perhaps a temporary file beside
it (`find_leftovers`). After a power cut the same holds: the content is on the disk before the rename, and the rename is
before `write_atomic` returns, so files written one after the other also arrive one after the other. That is as much as
the disk and the file system keep of what they promise for fsync.
"""

from __future__ import annotations

import json
import os
import re
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from multicam.errors import DataError


@contextmanager
def write_atomic(path: Path) -> Generator[Path]:
    """Yields a temporary path in the target's folder and renames it onto `path` when the block succeeds.

    A block that raises, or a killed process, leaves the old file untouched.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    temporary = Path(name)
    try:
        os.close(handle)
        yield temporary
        # mkstemp makes private files; results get the permissions any other new file would have.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        with open(temporary, "rb") as stream:
            os.fsync(stream.fileno())
        temporary.replace(path)
        _sync_folder(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def _sync_folder(folder: Path) -> None:
    """Has the disk keep the names in a folder; Windows has no call for that."""
    if os.name == "nt":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


_TEMPORARY = re.compile(r"\..+-[a-z0-9_]{8}(\.\w+)?")
"""Names that `write_atomic` gives to its temporary files."""


def find_leftovers(folder: Path, recursive: bool = True) -> list[Path]:
    """Temporary files that killed writers left in a folder; with no writer at work there, they may be removed."""
    paths = folder.rglob(".*") if recursive else folder.glob(".*")
    return sorted(path for path in paths if _TEMPORARY.fullmatch(path.name) and path.is_file())


def write_bytes(path: Path, data: bytes) -> None:
    """Writes bytes atomically."""
    with write_atomic(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Writes UTF-8 text atomically."""
    write_bytes(path, text.encode())


def write_json(path: Path, value: Any, indent: int | None = None) -> None:
    """Writes JSON atomically; NaN and infinity are refused, for they are not JSON."""
    write_text(path, json.dumps(value, indent=indent, allow_nan=False) + "\n")


def read_json(path: Path) -> Any:
    """Reads a JSON file.

    Raises:
        DataError: the file is missing or is not JSON; the sentence says where it breaks.
    """
    require_file(path)
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise DataError(
            f"{path} is not valid JSON: {error.msg} at line {error.lineno}, column {error.colno}."
        ) from error
    except UnicodeDecodeError as error:
        raise DataError(f"{path} is not a text file: byte {error.start} is not UTF-8.") from error


def require_file(path: Path, what: str = "file") -> Path:
    """Returns `path` if it is a file.

    Raises:
        DataError: it is missing; the sentence names the nearest folder that does exist.
    """
    if path.is_file():
        return path
    if path.is_dir():
        raise DataError(f"{path} is a folder where a {what} was expected.")
    raise _missing(path, what)


def require_folder(path: Path, what: str = "folder") -> Path:
    """Returns `path` if it is a folder.

    Raises:
        DataError: it is missing or is a file.
    """
    if path.is_dir():
        return path
    if path.exists():
        raise DataError(f"{path} is a file where a {what} was expected.")
    raise _missing(path, what)


def _missing(path: Path, what: str) -> DataError:
    parent = next(p for p in path.absolute().parents if p.exists())
    return DataError(f"The {what} {path} does not exist; the nearest existing folder is {parent}.")
