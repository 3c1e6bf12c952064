"""The whole street in one command: CAD models, renders, training, ONNX, a run on a recording, its evaluation.

Every step is a `multicam` command that continues what an earlier, killed attempt left, so starting this again is
always safe. Results stand in $MULTICAM_DATA/e2e; report.txt there holds the times and the errors.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from multicam.files import write_text

ROOT = Path(os.environ.get("MULTICAM_DATA", "data")) / "e2e"
MULTICAM = str(Path(sys.executable).parent / "multicam")


def steps(root: Path) -> dict[str, list[str]]:
    """The commands, in order; every path lies below `root`."""
    models, recording = str(root / "models"), str(root / "recording")
    network, train, run = str(root / "network.onnx"), root / "train-run", str(root / "run")
    data = ["--data.train", str(root / "train"), "--data.validation", str(root / "val"), "--data.models", models]
    render = ["datagen", "render", "--models", models, "--output", str(root)]
    return {
        "models": ["datagen", "models", "--output", models],
        "render": [*render, *config("render")],
        "render held-out": [*render, *config("render-val")],
        "sequence": ["datagen", "sequence", *config("sequence"), "--models", models, "--output", recording],
        "train": ["train", *config("train"), "--resume", "--output", str(train), *data],
        "export": ["export", "--checkpoint", str(train / "best"), "--output", network],
        "run": ["run", "--recording", recording, "--network", network, "--output", run],
        "evaluate": ["evaluate", "--run", run],
    }


def config(name: str) -> list[str]:
    """The flag for one of this street's configurations."""
    return ["--config", f"configs/e2e/{name}.yaml"]


def main() -> None:
    """Runs every step; a failing one ends this script with its own exit code."""
    times: list[str] = []
    for name, arguments in steps(ROOT).items():
        print("$ multicam", " ".join(arguments), flush=True)
        start = time.monotonic()
        code = subprocess.run([MULTICAM, *arguments], check=False).returncode
        if code:
            sys.exit(code)
        times.append(f"{name:<16} {time.monotonic() - start:7.0f} s")
    errors = (ROOT / "run" / "evaluation.txt").read_text(encoding="utf-8")
    write_text(ROOT / "report.txt", "\n".join(times) + "\n\n" + errors)
    print((ROOT / "report.txt").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
