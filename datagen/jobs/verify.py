"""Is a data set what its manifests say? Every file is read again and compared, every label has its pixels."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from datagen import GENERATOR_VERSION
from datagen.config import DatagenConfig
from datagen.pictures.generate import is_finished, missing_images
from datagen.pictures.manifest import Manifest, entry_of, list_files, read_manifest
from multicam.config import load_config, read_yaml
from multicam.errors import DataError, MulticamError
from multicam.files import find_leftovers
from multicam.progress import Progress, SilentProgress

_TABLES = ("scene_gt", "scene_gt_info", "scene_camera", "scene_keypoints")
_PICTURES = ("rgb", "depth")
_MASKS = ("mask", "mask_visib")


_NAMED = 5
"""Unfinished scenes that are named."""


@dataclass(frozen=True)
class Report:
    """What was found.

    Attributes:
        problems: one sentence each, in the order of the scenes.
        scenes, pictures, files: how many were compared.
    """

    problems: tuple[str, ...]
    scenes: int
    pictures: int
    files: int


def find_splits(folder: Path) -> list[Path]:
    """The split folders of a data set, or the folder itself if it is one.

    Raises:
        DataError: nothing that `multicam datagen render` made is there.
    """
    splits = sorted(path.parent for path in (*folder.glob("config.yaml"), *folder.glob("*/config.yaml")))
    # Recordings have a configuration too, of another kind.
    splits = [split for split in splits if "images_per_scene" in read_yaml(split / "config.yaml")]
    if not splits:
        raise DataError(
            f"{folder} holds no data set of multicam datagen render: neither it nor a folder in it has the "
            "config.yaml of one."
        )
    return splits


def verify_split(split: Path, workers: int, progress: Progress | None = None) -> Report:
    """Compares a split with its configuration and manifests, in `workers` threads.

    Raises:
        ConfigError, DataError: its configuration does not read.
    """
    config = replace(load_config(DatagenConfig, split / "config.yaml"), output=split.parent, split=split.name)
    if not (split / "generator.json").is_file():
        return Report((f"{split} was made by a version of the generator that wrote no manifests.",), 0, 0, 0)
    expected = [split / f"{index:06d}" for index in range(config.scenes)]
    strangers = sorted({path for path in split.iterdir() if path.is_dir()} - set(expected))
    problems = [f"{path} is left by a killed writer." for path in find_leftovers(split, recursive=False)]
    problems += [f"{path} is no scene of this data set." for path in strangers]
    # Threads suffice: reading and hashing leave Python's lock alone.
    with ThreadPoolExecutor(workers) as pool:
        checks = pool.map(lambda index: _check_scene(config, split, index), range(config.scenes))
        found = list((progress or SilentProgress()).track(checks, f"verifying {split.name}", config.scenes))
    problems += [problem for scene in found for problem in scene.problems]
    whole = {path.name: s.manifest for path, s in zip(expected, found, strict=True) if s.manifest is not None}
    problems += _disagreements(whole)
    problems += _unfinished(split, {i: scene.lacking for i, scene in enumerate(found) if scene.lacking is not None})
    pictures = sum(manifest.images for manifest in whole.values())
    return Report(tuple(problems), len(whole), pictures, sum(len(manifest.files) for manifest in whole.values()))


@dataclass(frozen=True)
class _Scene:
    """What was found of a scene; `lacking` pictures, or None if it is finished or its labels do not read."""

    problems: tuple[str, ...]
    manifest: Manifest | None = None
    lacking: int | None = None


def _check_scene(config: DatagenConfig, split: Path, index: int) -> _Scene:
    folder = split / f"{index:06d}"
    problems = [f"{path} is left by a killed writer." for path in find_leftovers(folder)]
    try:
        manifest = read_manifest(folder)
        if manifest is not None:
            problems += _compare_files(folder, manifest)
            problems += _compare_labels(folder, manifest)
            if (manifest.scene, manifest.seed) != (index, config.seed):
                problems.append(f"{folder} holds scene {manifest.scene} of seed {manifest.seed}.")
        lacking = None if is_finished(config, index) else len(missing_images(config, index))
    except MulticamError as error:
        return _Scene((*problems, str(error)))
    return _Scene(tuple(problems), manifest, lacking)


def _unfinished(split: Path, lacking: dict[int, int]) -> Iterator[str]:
    """One sentence for all scenes that are still to be finished."""
    if lacking:
        names = ", ".join(f"{index:06d}" for index in list(lacking)[:_NAMED])
        more = f" and {len(lacking) - _NAMED} more" if len(lacking) > _NAMED else ""
        yield (
            f"{split} has {len(lacking)} unfinished scenes ({names}{more}), which lack {sum(lacking.values())} "
            f"pictures; `multicam datagen render --config {split / 'config.yaml'}` goes on."
        )


def _compare_files(folder: Path, manifest: Manifest) -> Iterator[str]:
    there = {str(path.relative_to(folder)) for path in list_files(folder)}
    for name, entry in manifest.files.items():
        path = folder / name
        if name not in there:
            yield f"{path} is missing."
        elif (found := entry_of(path)) != entry:
            how = f"torn: {found.size} bytes of {entry.size}" if found.size != entry.size else "not what was written"
            yield f"{path} is {how}."
    yield from (f"{folder / name} is not in the manifest." for name in sorted(there - manifest.files.keys()))


def _compare_labels(folder: Path, manifest: Manifest) -> Iterator[str]:
    """Every image has one row in every table, one picture of each kind, and two masks for each labelled object."""
    wanted = {str(im_id) for im_id in range(manifest.images)}
    tables = {name: _read_rows(folder / f"{name}.json") for name in _TABLES}
    for name, rows in tables.items():
        for key, count in Counter(key for key, _ in rows).items():
            if count > 1:
                yield f"{folder / name}.json has image {key} {count} times."
        if missing := sorted(wanted - {key for key, _ in rows}, key=int):
            yield f"{folder / name}.json lacks image {', '.join(missing)}."
    truth, files = dict(tables["scene_gt"]), Counter(str(Path(name).with_suffix("")) for name in manifest.files)
    for key, objects in truth.items():
        for name, rows in tables.items():
            if name != "scene_camera" and len(dict(rows).get(key, objects)) != len(objects):
                yield f"{folder / name}.json has another number of objects in image {key} than scene_gt.json."
        stem = f"{int(key):06d}"
        needed = [f"{kind}/{stem}" for kind in _PICTURES]
        needed += [f"{kind}/{stem}_{index:06d}" for kind in _MASKS for index in range(len(objects))]
        for name in needed:
            if files[name] != 1:
                yield f"{folder / name} is there {files[name]} times, as the manifest has it."
    masks = sum(count for name, count in files.items() if name.split("/")[0] in _MASKS)
    if masks != len(_MASKS) * sum(len(objects) for objects in truth.values()):
        yield f"{folder} has {masks} masks, which is not two for each label."


def _read_rows(path: Path) -> list[tuple[str, Any]]:
    """The rows of a table in order, those with the same key too.

    Raises:
        DataError: it is missing or no JSON.
    """
    try:
        # As pairs, since a mapping would keep the last of two rows in silence.
        return json.loads(path.read_text(), object_pairs_hook=list)
    except (FileNotFoundError, json.JSONDecodeError) as error:
        raise DataError(f"{path} does not read: {error}.") from error


def _disagreements(manifests: dict[str, Manifest]) -> Iterator[str]:
    """Scenes that were made otherwise than most."""
    kinds = {name: (m.generator, m.config, m.models) for name, m in manifests.items()}
    if not kinds:
        return
    usual = Counter(kinds.values()).most_common(1)[0][0]
    for name, kind in kinds.items():
        if kind != usual:
            yield f"Scene {name} was made with another configuration, other models or another version than the rest."
    if usual[0] != GENERATOR_VERSION:
        yield f"The data set was made by version {usual[0]} of the generator; this is version {GENERATOR_VERSION}."
