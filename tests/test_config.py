"""Configuration: strict YAML into frozen dataclasses, flags on top, and sentences that name the fault."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any, Literal

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from multicam.config import from_mapping, load_config, parse_command, save_config, to_mapping
from multicam.errors import ConfigError, DataError


class Speed(Enum):
    FAST = "fast"
    EXACT = "exact"


@dataclass(frozen=True)
class Layer:
    """One layer."""

    width: int = 8
    rate: float = 0.5


@dataclass(frozen=True)
class Solver:
    """Settings of a solver."""

    steps: int = 10
    tolerance: float = 1e-6
    robust: bool = True

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError(f"steps must be positive, got {self.steps}")


@dataclass(frozen=True)
class Job:
    """Every kind of field that our configurations use."""

    name: str = "job"
    solver: Solver = Solver()
    layers: tuple[Layer, ...] = (Layer(),)
    strides: tuple[int, ...] = (8, 16)
    size: tuple[int, int] = (640, 480)
    words: tuple[str, ...] = ()
    mode: Literal["paper", "better"] = "better"
    speed: Speed = Speed.FAST
    output: Path | None = None
    polish: Solver | None = None
    limit: float | None = None
    weights: dict[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True)
class Command:
    """A command with fields that must be given."""

    dataset: Path
    count: int
    solver: Solver = Solver()


def solvers() -> st.SearchStrategy[Solver]:
    return st.builds(Solver, st.integers(1, 10**9), st.floats(allow_nan=False), st.booleans())


def jobs() -> st.SearchStrategy[Job]:
    # YAML knows no lone surrogates and no control characters.
    text = st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]), max_size=12)
    return st.builds(
        Job,
        name=text,
        solver=solvers(),
        layers=st.lists(st.builds(Layer, st.integers(), st.floats(allow_nan=False)), max_size=3).map(tuple),
        strides=st.lists(st.integers(), max_size=3).map(tuple),
        size=st.tuples(st.integers(), st.integers()),
        words=st.lists(text, max_size=3).map(tuple),
        mode=st.sampled_from(["paper", "better"]),
        speed=st.sampled_from(Speed),
        output=st.none() | st.sampled_from([Path("a/b"), Path("/x.yaml"), Path("1e3"), Path("null")]),
        polish=st.none() | solvers(),
        limit=st.none() | st.floats(allow_nan=False),
        weights=st.dictionaries(text, st.floats(allow_nan=False), max_size=3),
    )


def write(folder: Path, text: str) -> Path:
    path = folder / "config.yaml"
    path.write_text(text)
    return path


@given(jobs())
def test_saved_configurations_come_back_unchanged(tmp_path_factory: pytest.TempPathFactory, job: Job) -> None:
    path = tmp_path_factory.getbasetemp() / "config.yaml"
    save_config(job, path)
    assert load_config(Job, path) == job
    assert from_mapping(Job, to_mapping(job), "test") == job
    assert yaml.safe_load(path.read_text()).keys() == to_mapping(job).keys()


def test_a_file_holds_only_what_differs(tmp_path: Path) -> None:
    path = write(tmp_path, "solver: {tolerance: 1e-3}\nlayers:\n- width: 3\n- {}\n")
    expected = Job(solver=Solver(tolerance=0.001), layers=(Layer(width=3), Layer()))
    assert load_config(Job, path) == expected
    assert load_config(Job) == Job()
    assert load_config(Job, write(tmp_path, "# nothing\n")) == Job()


@pytest.mark.parametrize("number", ["1e-3", "1E-3", "1.e-3", "+1e-3", "0.001", ".1e-2", "10e-4"])
def test_numbers_with_an_exponent_are_numbers(tmp_path: Path, number: str) -> None:
    assert load_config(Solver, write(tmp_path, f"tolerance: {number}")).tolerance == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "solver: {step: 3}",
            'unknown key "solver.step" (did you mean "steps"?); the keys there are steps, tolerance,',
        ),
        ("layers: [{width: 3}, {widht: 4}]", 'unknown key "layers[1].widht" (did you mean "width"?)'),
        ("polish: {stesp: 3}", 'unknown key "polish.stesp" (did you mean "steps"?)'),
        ("slover: {}", 'unknown key "slover" (did you mean "solver"?)'),
        ("1: 2", 'unknown key "1"; the keys there are name,'),
        ('solver: {robust: "False"}', "solver.robust: expected bool, got 'False'."),
        ("solver: {robust: 1}", "solver.robust: expected bool, got 1."),
        ('solver: {steps: "3"}', "solver.steps: expected int, got '3'."),
        ("solver: {steps: 3.0}", "solver.steps: expected int, got 3.0."),
        ("solver: {steps: true}", "solver.steps: expected int, got True."),
        ("solver: {tolerance: small}", "solver.tolerance: expected float, got 'small'."),
        ("solver: {tolerance: true}", "solver.tolerance: expected float, got True."),
        ("solver: {steps: 0}", "solver: steps must be positive, got 0."),
        ("solver: 3", "solver: expected a mapping of options, got 3."),
        ("solver:", "solver: expected a mapping of options, got None."),
        ("layers: {width: 3}", "layers: expected a list, got {'width': 3}."),
        ("layers: [3]", "layers[0]: expected a mapping of options, got 3."),
        ("words: hello", "words: expected a list, got 'hello'."),
        ("words: {a: 1}", "words: expected a list, got {'a': 1}."),
        ("strides: 8", "strides: expected a list, got 8."),
        ("strides: [8, x]", "strides[1]: expected int, got 'x'."),
        ("size: [1, 2, 3]", "size: Too many values in [1, 2, 3]"),
        ("mode: papre", "mode: expected one of paper, better, got 'papre' (did you mean \"paper\"?)."),
        ("speed: slow", "speed: 'slow' is not a valid Speed."),
        ("output: 3", "output: expected str, got 3."),
        ("limit: x", "limit: expected float, got 'x'."),
        ("weights: {a: b}", "weights['a']: expected float, got 'b'."),
        ("name: 3", "name: expected str, got 3."),
        ("name:", "name: expected str, got None."),
    ],
)
def test_what_does_not_fit_is_refused_with_its_path(tmp_path: Path, text: str, sentence: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_config(Job, path)
    assert str(caught.value).startswith(f"{path}: {sentence}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a: [", "is not valid YAML: expected the node content, but found '<stream end>' at line 1, column 5."),
        ("a: 1\n b: 2", "is not valid YAML: mapping values are not allowed here at line 2, column 3."),
        ("a: 1\na: 2", 'is not valid YAML: the key "a" is given twice at line 1, column 1.'),
        ("a: 1\nb: {c: 1, c: 2}", 'is not valid YAML: the key "c" is given twice at line 2, column 4.'),
        ("- 1", "holds a list at its top; write a mapping"),
        ("name: \x01", "is not valid YAML: it holds characters that YAML does not allow."),
        ("name: !!python/name:os.system", "is not valid YAML: could not determine a constructor"),
        ("? [1, 2]\n: 3", "is not valid YAML: found unhashable key"),
    ],
)
def test_malformed_yaml_is_refused_with_line_and_column(tmp_path: Path, text: str, sentence: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_config(Job, path)
    assert str(caught.value).startswith(f"{path} {sentence}")


def test_bytes_that_are_no_text_and_a_missing_file_are_refused(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_bytes(b"name: \xff\xfe")
    with pytest.raises(ConfigError, match="characters that YAML does not allow"):
        load_config(Job, tmp_path / "config.yaml")
    with pytest.raises(DataError, match=r"configuration file .*absent\.yaml does not exist"):
        load_config(Job, tmp_path / "absent.yaml")


def parse(schema: Any, *argv: str) -> Any:
    return parse_command(schema, list(argv), "multicam test", "Tests.")


def test_flags_go_over_the_file_and_the_file_over_the_defaults(tmp_path: Path) -> None:
    path = str(write(tmp_path, "name: file\nsolver: {steps: 3, tolerance: 1e-3}\nstrides: [1, 2, 3]\n"))
    assert parse(Job) == Job()
    from_file = replace(Job(), name="file", solver=Solver(3, 1e-3), strides=(1, 2, 3))
    assert parse(Job, "--config", path) == from_file
    expected = replace(from_file, solver=Solver(7, 1e-3, robust=False), strides=(4,))
    flags = ["--solver.steps", "7", "--solver.no-robust", "--strides", "4"]
    assert parse(Job, *flags, "--config", path) == expected
    assert parse(Job, f"--config={path}", *flags) == expected


def test_required_fields_may_come_from_either(tmp_path: Path) -> None:
    path = str(write(tmp_path, "count: 4\nsolver: {steps: 3}\n"))
    expected = Command(Path("data"), 4, Solver(3))
    assert parse(Command, "--config", path, "--dataset", "data") == expected
    assert parse(Command, "--dataset", "data", "--count", "4", "--solver.steps", "3") == expected
    whole = str(write(tmp_path, "count: 4\nsolver: {steps: 3}\ndataset: data\n"))
    assert parse(Command, "--config", whole) == expected


@pytest.mark.parametrize("argv", [["--dataset", "data"], ["--count", "4"], []])
def test_a_required_field_that_nobody_gives_ends_with_code_2(
    argv: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        parse(Command, *argv)
    assert caught.value.code == 2
    assert "required" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("flags", "hint"),
    [
        (["--solver.stesp", "3"], "--solver.steps"),
        (["--solver.steps", "many"], "--solver.steps"),
        (["--mode", "papre"], "paper"),
        (["--solver.steps", "0"], "steps must be positive, got 0"),
    ],
)
def test_a_flag_that_does_not_fit_ends_with_code_2_and_a_hint(
    flags: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        parse(Job, *flags)
    assert caught.value.code == 2
    assert hint in capsys.readouterr().err


def test_help_shows_the_options_and_ends_with_code_0(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        parse(Command, "--help")
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert all(word in text for word in ("multicam test", "--config FILE.yaml", "--solver.steps INT", "--dataset PATH"))


def test_a_fault_in_the_file_is_told_before_the_flags_are_read(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r'unknown key "solver.step" \(did you mean "steps"\?\)'):
        parse(Command, "--config", str(write(tmp_path, "solver: {step: 3}")))
    with pytest.raises(ConfigError, match=r'unknown key "datast" \(did you mean "dataset"\?\)'):
        parse(Command, "--config", str(write(tmp_path, "datast: data")))
    with pytest.raises(ConfigError, match=r"count: expected int, got 'x'"):
        parse(Command, "--config", str(write(tmp_path, "count: x")))
    with pytest.raises(ConfigError, match="--config needs a file"):
        parse(Job, "--config")
