"""Builds the wheel, installs it with plain pip into an empty environment, runs the demo and a registration there."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
EXAMPLE = REPOSITORY / "examples" / "register"


def main() -> None:
    """Stops with the failing command's own exit code."""
    with tempfile.TemporaryDirectory(prefix="multicam-wheel-") as name:
        folder = Path(name)
        run([sys.executable, "-m", "build", "--wheel", "--outdir", str(folder / "dist"), str(REPOSITORY)])
        (wheel,) = (folder / "dist").glob("*.whl")
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB")
        venv.create(folder / "env", with_pip=True)
        binary = folder / "env" / "bin"
        run([str(binary / "pip"), "install", "--quiet", str(wheel)])
        # The working folder is empty, so nothing of the checkout can be imported by accident.
        work = folder / "work"
        work.mkdir()
        run([str(binary / "multicam"), "doctor"], cwd=work)
        run([str(binary / "multicam"), "demo", "--output", "demo"], cwd=work)
        register = ["--dataset", str(EXAMPLE), "--candidates", str(EXAMPLE / "estimates.csv")]
        register += ["--groups", str(EXAMPLE / "groups.json"), "--output", "predictions.json"]
        run([str(binary / "multicam"), "register", *register], cwd=work)
        groups = json.loads((work / "predictions.json").read_text())["groups"]
        print(f"the wheel works: demo ran, {len(groups)} groups registered")


def run(command: list[str], cwd: Path | None = None) -> None:
    """Runs a command with its output shown; a failure ends this script with the same code."""
    print("$", " ".join(command), flush=True)
    code = subprocess.run(command, cwd=cwd, check=False).returncode
    if code:
        sys.exit(code)


if __name__ == "__main__":
    main()
