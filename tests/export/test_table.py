"""The table of costs: operations against those counted layer by layer, times measured, three forms."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
import torch

from export import cli, table
from export.table import TableConfig, make_table
from models.config import ModelConfig
from models.detector import Detector, count_parameters
from models.profile import profile
from multicam.errors import ConfigError, ModelError
from multicam.progress import SilentProgress
from tests.export.conftest import HEIGHT, ROWS, WIDTH


def convolution_flops(config: ModelConfig, width: int, height: int) -> int:
    """Twice the multiplications of every convolution of one picture, by its weight and its output."""
    total = 0

    def count(layer: torch.nn.Conv2d, _inputs: object, output: torch.Tensor) -> None:
        nonlocal total
        total += 2 * layer.weight[0].numel() * output.numel()

    with torch.device("meta"):
        detector = Detector(config).fuse()
        for layer in detector.modules():
            if isinstance(layer, torch.nn.Conv2d):
                layer.register_forward_hook(count)
        detector(torch.zeros(1, 3, height, width))
    return total


@pytest.mark.parametrize("neck", ["pafpn", "hybrid"])
def test_operations_are_those_of_the_layers_and_little_more(neck: str) -> None:
    config = ModelConfig(3, "nano", neck)
    cost, convolutions = profile(config, 640, 640, 100), convolution_flops(config, 640, 640)
    # Decoding, and attention of the hybrid neck, are the rest.
    assert 1.0 < cost.flops / convolutions < 1.25
    assert cost.parameters == count_parameters(Detector(config).fuse())


def test_four_times_the_pixels_cost_four_times_the_convolutions() -> None:
    config = ModelConfig(3, "nano")
    decoding = [profile(config, w, h, 20).flops - convolution_flops(config, w, h) for w, h in ((128, 96), (256, 192))]
    assert decoding[0] == decoding[1]
    assert convolution_flops(config, 256, 192) == 4 * convolution_flops(config, 128, 96)


def quick(**changes: object) -> TableConfig:
    options = {"sizes": ("nano", "m"), "necks": ("pafpn",), "timed": (), "width": WIDTH, "height": HEIGHT}
    return TableConfig(**{**options, **changes})


def test_costs_need_no_times() -> None:
    found = make_table(quick(), SilentProgress())
    assert [row[:2] for row in found.rows] == [("nano", "pafpn"), ("m", "pafpn")]
    assert found.rows[0][2] < found.rows[1][2]
    assert found.rows[0][3] < found.rows[1][3]
    assert len(found.columns) == 4
    assert "ONNX Runtime" not in found.note


def test_timed_networks_have_a_time_for_each_batch(exported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "write_onnx", lambda _d, _m, path: path.write_bytes(exported.read_bytes()))
    found = make_table(quick(timed=("nano",), rounds=3, rows=ROWS, threads=1), SilentProgress())
    assert [column.name for column in found.columns[4:]] == ["cpu, 1 view, ms", "cpu, 3 views, ms"]
    one, three = found.rows[0][4:]
    assert 0 < one < three
    assert found.rows[1][4:] == (None, None)
    assert "1 CPU threads" in found.note


def test_the_command_writes_the_form_that_the_suffix_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    flags = ["--sizes", "nano", "--necks", "pafpn", "--width", "96", "--height", "64", "--timed"]
    for suffix in (".md", ".csv", ".txt"):
        cli.main(["table", *flags, "--output", str(tmp_path / f"table{suffix}")])
    shown = capsys.readouterr().out
    assert shown.startswith("Networks at 96 x 64\n")
    assert (tmp_path / "table.txt").read_text() == shown[: len(shown) // 3]
    lines = (tmp_path / "table.md").read_text().splitlines()
    assert lines[0] == "| size | neck | parameters, M | GFLOPs |"
    assert lines[2].startswith("| nano | pafpn | 2.55 | ")
    with open(tmp_path / "table.csv") as stream:
        (row,) = csv.DictReader(stream)
    assert float(row["parameters, M"]) == pytest.approx(2.55, abs=0.01)


def test_unfit_options_are_refused() -> None:
    with pytest.raises(ConfigError, match="multiple of 32"):
        quick(width=100)
    with pytest.raises(ConfigError, match=r"\.md"):
        quick(output=Path("table.pdf"))
    with pytest.raises(ModelError, match='no execution provider "cuda"'):
        make_table(quick(timed=("nano",), providers=("cuda",)), SilentProgress())
