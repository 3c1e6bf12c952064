from __future__ import annotations

import shutil

import pytest

from multicam import cli
from multicam.commands import demo


@pytest.fixture
def shipped(marked, tmp_path, monkeypatch):
    """The toy recording and network in the place of the package's own."""
    assets = tmp_path / "package" / "assets"
    shutil.copytree(marked.recording, assets / demo.RECORDING)
    shutil.copy(marked.network, assets / demo.NETWORK)
    monkeypatch.setattr(demo.resources, "files", lambda package: tmp_path / "package")
    return assets


def test_the_demo_prints_errors_times_coverage_and_the_page(shipped, tmp_path, capsys):
    assert cli.run(["demo", "--output", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    # The recording measures depth, to which estimates are brought, and on which keyframes are adjusted.
    for text in (
        "Camera errors",
        "Time per step",
        "\nfit ",
        "Bundle adjustment",
        "Coverage",
        f"Report: {tmp_path / 'out' / 'report.html'}",
    ):
        assert text in printed
    assert "<caption>Camera errors</caption>" in (tmp_path / "out" / "report.html").read_text()


def test_an_installation_without_assets_says_so(shipped, tmp_path, capsys):
    (shipped / demo.NETWORK).unlink()
    assert cli.run(["demo", "--output", str(tmp_path / "out")]) == 2
    assert "instruments.onnx is not part of this installation" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
