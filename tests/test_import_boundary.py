"""The runtime imports without the packages of training and rendering, and the command line without the heavy ones."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

FOREIGN = (
    # Training, export, data generation and their libraries; what only tests and viewers need.
    "models", "train", "datagen", "export", "torch", "torchvision", "kornia", "albumentations", "tensorboard",
    "safetensors", "onnx", "onnxscript", "bpy", "mathutils", "manifold3d", "viser", "pytest", "hypothesis", "beartype",
)  # fmt: skip

HEAVY = ("numpy", "cv2", "scipy", "onnxruntime", "numba", "trimesh", "matplotlib", "tyro", "cattrs", "yaml", "jinja2")

# To an import and to importlib.util.find_spec alike, such a package is not installed.
BLOCK = f"import sys; sys.modules.update(dict.fromkeys({FOREIGN}))\n"

MODULES = tuple(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in sorted((ROOT / "multicam").rglob("*.py"))
    if path.name != "__init__.py"
)

IMPORT_ALL = f"""
import importlib

for name in {MODULES}:
    importlib.import_module(name)
"""

# Forked from one process that has the libraries loaded, each child imports one module of ours.
IMPORT_EACH_ALONE = f"""
import importlib, os
import cattrs, cv2, jaxtyping, jinja2, matplotlib.figure, numba, onnxruntime, scipy.optimize, trimesh, yaml

failed = False
for name in {MODULES}:
    child = os.fork()
    if child == 0:
        try:
            importlib.import_module(name)
        except BaseException as error:
            print(name, repr(error), flush=True)
            os._exit(1)
        os._exit(0)
    failed |= os.waitpid(child, 0)[1] != 0
raise SystemExit(failed)
"""


def run(script: str) -> str:
    """Runs a script in a fresh interpreter at the root of the repository and returns what it prints."""
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_runtime_imports_without_training_and_rendering() -> None:
    assert len(MODULES) > 20
    run(BLOCK + IMPORT_ALL)


def test_the_blocker_blocks() -> None:
    refused = "try:\n import models\nexcept ModuleNotFoundError as error:\n print(error.name)"
    assert run(BLOCK + refused).strip() == "models"


def test_every_module_can_be_the_first_one_imported() -> None:
    """A circle of imports shows only when it is entered at the wrong place."""
    run(BLOCK + IMPORT_EACH_ALONE)


def test_the_command_line_starts_without_heavy_libraries() -> None:
    loaded = run(f"import multicam.cli, sys; print(*[name for name in {HEAVY} if name in sys.modules])")
    assert loaded.split() == []


def test_the_overview_is_printed_without_heavy_libraries() -> None:
    script = (
        "import sys; from multicam.cli import run\nassert run(['--help']) == 0\n"
        f"print('loaded:', *[name for name in {HEAVY} if name in sys.modules])"
    )
    assert run(script).splitlines()[-1].split() == ["loaded:"]
