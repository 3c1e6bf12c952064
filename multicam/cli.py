"""The `multicam` command: a table of subcommands, each imported only when it is asked for."""

from __future__ import annotations

import importlib
import logging
import os
import sys
from collections.abc import Callable

from multicam import __version__
from multicam.commands.table import SUBCOMMANDS
from multicam.errors import MissingDependencyError, MulticamError, did_you_mean

USAGE_ERROR = 2
INTERRUPTED = 130


def main() -> None:
    """Entry point of the console script; ends the process with the exit code."""
    # Our matrices are tiny: waking BLAS threads for each costs more than the work, 5 ms a call on a busy machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        code = run(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of our output closed it, as `| head` does; silence the interpreter's own complaint at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    sys.exit(code)


def run(argv: list[str]) -> int:
    """Runs one subcommand and returns the exit code: 0 done, 2 a mistake in the input, 130 interrupted."""
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    if not argv or argv[0] in ("-h", "--help"):
        print(_overview())
        return 0 if argv else USAGE_ERROR
    if argv[0] == "--version":
        print(f"multicam-pose {__version__}")
        return 0
    try:
        _load(argv[0])(argv[1:])
    except MulticamError as error:
        print(f"multicam {argv[0]}: {error}", file=sys.stderr)
        return USAGE_ERROR
    except KeyboardInterrupt:
        print(f"multicam {argv[0]}: interrupted; what was finished is kept.", file=sys.stderr)
        return INTERRUPTED
    return 0


def _load(name: str) -> Callable[[list[str]], None]:
    if name not in SUBCOMMANDS:
        raise MulticamError(
            f'there is no subcommand "{name}"{did_you_mean(name, SUBCOMMANDS)}; choose from {", ".join(SUBCOMMANDS)}.'
        )
    command = SUBCOMMANDS[name]
    try:
        return importlib.import_module(command.module).main
    except ModuleNotFoundError as error:
        package = (error.name or "").split(".")[0]
        if package == "multicam":
            raise
        if package == command.module.split(".")[0]:
            raise MissingDependencyError(
                f"`multicam {name}` runs from a checkout of the repository, not from the installed package: "
                f'clone it and `pip install -e ".[{command.extra}]"` there.'
            ) from error
        install = f'pip install -e ".[{command.extra}]"' if command.extra else "pip install multicam-pose"
        raise MissingDependencyError(
            f'`multicam {name}` needs the package "{package}", which is not installed: `{install}`.'
        ) from error


def _overview() -> str:
    width = max(map(len, SUBCOMMANDS))
    rows = "\n".join(f"  {name:<{width}}  {command.summary}" for name, command in SUBCOMMANDS.items())
    return (
        "usage: multicam SUBCOMMAND [options]\n\n"
        "Finds the poses of several cameras from known objects they see: no markers, no calibration session.\n\n"
        f"{rows}\n\n"
        "`multicam SUBCOMMAND --help` explains each; start with `multicam demo`."
    )
