"""`multicam doctor`: versions, providers, and what each subcommand still needs."""

from __future__ import annotations

import ctypes.util
import importlib.metadata
import importlib.util
import os
import platform
from dataclasses import dataclass
from importlib import resources

from rich.console import Console
from rich.table import Table

from multicam import __version__
from multicam.commands.table import SUBCOMMANDS
from multicam.config import parse_command

RUNTIME = ("numpy", "scipy", "opencv-python-headless", "onnxruntime", "numba", "trimesh", "matplotlib")
"""Distributions every runtime subcommand uses."""

EXTRA_MODULES = {
    "datagen": {"bpy": "bpy", "manifold3d": "manifold3d"},
    "train": {"torch": "torch", "torchvision": "torchvision", "kornia": "kornia", "albumentations": "albumentations",
              "tensorboard": "tensorboard", "safetensors": "safetensors"},
    "export": {"torch": "torch", "onnx": "onnx", "onnxscript": "onnxscript", "safetensors": "safetensors"},
}  # fmt: skip
"""Extra to {distribution: module} of what it adds."""

BPY_LIBRARIES = {
    "Xrender": "libxrender1", "Xi": "libxi6", "xkbcommon": "libxkbcommon0", "Xfixes": "libxfixes3",
    "SM": "libsm6", "GL": "libgl1",
}  # fmt: skip
"""Shared libraries that `import bpy` loads, and the Debian packages that hold them."""

ASSETS = {"instruments.onnx": "the demo's network", "recording": "the demo's recording"}


@dataclass(frozen=True)
class DoctorConfig:
    """Nothing to choose: the command looks at this machine and reports."""


def main(argv: list[str]) -> None:
    """Prints what is installed, what is missing and how to get it."""
    parse_command(DoctorConfig, argv, "multicam doctor", "Shows versions, providers and what each subcommand needs.")
    console = Console()
    console.print(
        f"multicam-pose {__version__}, Python {platform.python_version()}, {platform.system()} {platform.machine()}, "
        f"{os.cpu_count()} cores"
    )
    console.print(_versions())
    console.print(f"ONNX Runtime providers: {', '.join(_providers()) or 'none, onnxruntime is not installed'}")
    console.print(_subcommands())


def missing_for(name: str) -> list[str]:
    """What the subcommand lacks, each with the command that brings it; empty when it can run."""
    command = SUBCOMMANDS[name]
    needs: list[str] = []
    lacking = [d for d in RUNTIME if _version(d) is None]
    if lacking:
        needs.append(f"{', '.join(lacking)}: pip install multicam-pose")
    if command.extra:
        if importlib.util.find_spec(command.module.split(".")[0]) is None:
            needs.append("a checkout of the repository: clone it and `pip install -e .` there")
        modules = EXTRA_MODULES[command.extra]
        absent = [d for d, module in modules.items() if importlib.util.find_spec(module) is None]
        if absent:
            needs.append(f'{", ".join(absent)}: pip install -e ".[{command.extra}]"')
    if name == "datagen":
        packages = [p for library, p in BPY_LIBRARIES.items() if ctypes.util.find_library(library) is None]
        if packages:
            needs.append(f"system libraries: apt-get install {' '.join(packages)}")
    if name == "demo":
        folder = resources.files("multicam") / "assets"
        needs += [f"{what} (multicam/assets/{n})" for n, what in ASSETS.items() if not (folder / n).exists()]  # pyright: ignore[reportAttributeAccessIssue, reportUnknownMemberType]
    return needs


def _versions() -> Table:
    table = Table(title="Packages", title_justify="left")
    table.add_column("package")
    table.add_column("version")
    extras = [d for modules in EXTRA_MODULES.values() for d in modules]
    for name in dict.fromkeys((*RUNTIME, *extras)):
        table.add_row(name, _version(name) or "not installed")
    return table


def _subcommands() -> Table:
    table = Table(title="Subcommands", title_justify="left")
    table.add_column("subcommand")
    table.add_column("needs")
    for name in SUBCOMMANDS:
        table.add_row(name, "\n".join(missing_for(name)) or "ready")
    return table


def _version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def _providers() -> list[str]:
    if importlib.util.find_spec("onnxruntime") is None:
        return []
    import onnxruntime

    return list(onnxruntime.get_available_providers())
