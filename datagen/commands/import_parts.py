"""`multicam datagen import`: any folder of CAD files and one YAML to a BOP models folder."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from datagen.cad.importer import ImportedPart, import_parts, parts_table
from datagen.cad.parts import parts_file, suggest
from multicam.config import parse_command
from multicam.errors import ConfigError
from multicam.progress import Progress, RichProgress

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class ImportConfig:
    """Options of `multicam datagen import`."""

    parts: Path
    """YAML file beside the meshes, or the folder of a parts.yaml; it states the unit and, where wished, names and
    symmetries."""
    output: Path | None = None
    """Models folder to write; FOLDER/models if left out."""
    keypoints: int = 8
    """Keypoints per object."""
    seed: int = 0
    """Seed of the surface samples that the keypoints are chosen from."""
    suggest: bool = False
    """Write a draft of the YAML file instead, with the size of each mesh in each unit."""
    replace: bool = False
    """Overwrite models imported from other parts; pictures and networks made with them no longer fit."""

    def __post_init__(self) -> None:
        if self.keypoints < 4:
            raise ConfigError(f"keypoints is {self.keypoints}, but a pose needs at least 4; ask for 4 or more.")
        if self.seed < 0:
            raise ConfigError(f"seed is {self.seed}; give zero or a positive whole number.")


def main(argv: list[str]) -> None:
    """Runs the command."""
    config = parse_command(
        ImportConfig, argv, "multicam datagen import", "Makes a BOP models folder of CAD files (PLY, OBJ, STL, GLB)."
    )
    parts = parts_file(config.parts)
    if config.suggest:
        suggest(parts)
        _LOG.info("wrote a draft to %s; fill in the unit, look through the names, then import", parts)
        return
    output = config.output or parts.parent / "models"
    rows = import_parts(parts, output, config.keypoints, config.seed, RichProgress(), config.replace)
    report(rows, parts)
    _LOG.info("the models are in %s; `multicam datagen inspect %s` shows them", output, output)


def import_folder(models: Path, output: Path, progress: Progress) -> Path:
    """The BOP models folder to render: the given one, or, for a folder with parts.yaml, its import.

    Args:
        output: data set folder; the import goes into its `models`, where an unchanged one is used again.

    Raises:
        ConfigError: parts.yaml does not fit.
        DataError: a mesh does not fit, or the parts have changed since they were imported.
    """
    parts = parts_file(models)
    if not models.is_dir() or not parts.is_file() or (models / "models_info.json").is_file():
        return models
    target = output / "models"
    report(import_parts(parts, target, ImportConfig.keypoints, ImportConfig.seed, progress), parts)
    return target


def report(rows: Sequence[ImportedPart], parts: Path) -> None:
    """Logs the table of the parts and, where symmetries were proposed, how to confirm or correct them."""
    _LOG.info("%s", parts_table(rows).to_text())
    proposed = [row for row in rows if row.proposed]
    if not proposed:
        return
    lines = "\n".join(f"  {row.file}: {row.statement}" for row in proposed)
    _LOG.info(
        "Symmetries of %d of %d parts were proposed from the shape alone; colours and prints do not count. To confirm "
        "or correct one, put its line, changed or not, beside the part in %s:\n%s",
        len(proposed),
        len(rows),
        parts,
        lines,
    )
