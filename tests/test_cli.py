"""The command line: help, exit codes, and one sentence for each mistake."""

from __future__ import annotations

import subprocess
import sys
from types import ModuleType

import pytest

from multicam import cli
from multicam.commands.table import Subcommand
from multicam.errors import DataError


@pytest.fixture
def fake_command(monkeypatch: pytest.MonkeyPatch):
    """Registers a subcommand whose main is the given function."""

    def register(main) -> None:
        module = ModuleType("fake_command")
        module.main = main
        monkeypatch.setitem(sys.modules, "fake_command", module)
        monkeypatch.setitem(cli.SUBCOMMANDS, "fake", Subcommand("fake_command", "for this test"))

    return register


def test_overview_names_every_subcommand(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in cli.SUBCOMMANDS)


def test_no_arguments_shows_the_overview_and_counts_as_a_mistake() -> None:
    assert cli.run([]) == cli.USAGE_ERROR


def test_misspelt_subcommand_is_refused_with_a_suggestion(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["regster"]) == cli.USAGE_ERROR
    message = capsys.readouterr().err
    assert 'did you mean "register"?' in message
    assert "Traceback" not in message


def test_a_users_mistake_becomes_one_sentence_and_code_2(fake_command, capsys: pytest.CaptureFixture[str]) -> None:
    def main(argv: list[str]) -> None:
        raise DataError("the file x.json does not exist.")

    fake_command(main)
    assert cli.run(["fake"]) == cli.USAGE_ERROR
    assert capsys.readouterr().err == "multicam fake: the file x.json does not exist.\n"


def test_our_own_mistake_keeps_its_traceback(fake_command) -> None:
    def main(argv: list[str]) -> None:
        raise ZeroDivisionError

    fake_command(main)
    with pytest.raises(ZeroDivisionError):
        cli.run(["fake"])


def test_interrupt_says_that_finished_work_is_kept(fake_command, capsys: pytest.CaptureFixture[str]) -> None:
    def main(argv: list[str]) -> None:
        raise KeyboardInterrupt

    fake_command(main)
    assert cli.run(["fake"]) == cli.INTERRUPTED
    assert "kept" in capsys.readouterr().err


def test_missing_package_names_the_extra_that_brings_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = Subcommand("json.absent_package", "for this test", "train")
    monkeypatch.setitem(cli.SUBCOMMANDS, "fake", module)

    def refuse(name: str) -> ModuleType:
        raise ModuleNotFoundError("No module named 'torch'", name="torch")

    monkeypatch.setattr(cli.importlib, "import_module", refuse)
    assert cli.run(["fake"]) == cli.USAGE_ERROR
    message = capsys.readouterr().err
    assert '"torch"' in message
    assert 'pip install -e ".[train]"' in message


def test_training_from_a_bare_wheel_says_that_it_needs_a_checkout(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(name: str) -> ModuleType:
        raise ModuleNotFoundError("No module named 'train'", name="train")

    monkeypatch.setattr(cli.importlib, "import_module", refuse)
    assert cli.run(["train"]) == cli.USAGE_ERROR
    assert "checkout" in capsys.readouterr().err


def test_output_into_a_closed_pipe_ends_quietly() -> None:
    # The sleep waits for the reader to be gone, so that the write meets a closed pipe every time.
    script = "import sys, time, multicam.cli; sys.argv[1:] = ['--help']; time.sleep(0.3); multicam.cli.main()"
    done = subprocess.run(
        ["bash", "-c", f'"{sys.executable}" -c "{script}" | true'], capture_output=True, text=True, check=False
    )
    assert done.stderr == ""


def test_doctor_lists_what_a_subcommand_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    from multicam.commands import doctor

    real = doctor.importlib.util.find_spec
    monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda name: None if name == "torch" else real(name))
    assert any("torch" in need and ".[train]" in need for need in doctor.missing_for("train"))
    assert not any("torch" in need for need in doctor.missing_for("run"))


def test_doctor_prints_providers(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["doctor"]) == 0
    assert "CPUExecutionProvider" in capsys.readouterr().out
