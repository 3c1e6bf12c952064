"""The verbs of `multicam datagen`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from datagen.cli import main
from datagen.pictures import renderer
from datagen.pictures.photo import develop
from datagen.scenes.spec import Shot
from multicam.errors import ConfigError, MissingDependencyError
from multicam.geometry.camera import Camera


def test_an_unknown_verb_gets_a_suggestion() -> None:
    with pytest.raises(ConfigError, match=r'"rendr".*did you mean "render"'):
        main(["rendr"])


@pytest.mark.parametrize("verb", ["render", "sequence"])
def test_help_explains_the_options(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([verb, "--help"])
    assert "--models" in capsys.readouterr().out


def test_without_a_verb_the_verbs_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    main([])
    listed = capsys.readouterr().out
    assert all(verb in listed for verb in ("models", "render", "sequence"))


def test_without_bpy_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(renderer.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(MissingDependencyError, match="datagen"):
        renderer.BlenderRenderer(Path("none"), 1)


def test_exposure_is_automatic_and_stops_shift_it(rng: np.random.Generator) -> None:
    color = rng.uniform(0.2, 0.4, size=(24, 32, 3)).astype(np.float32)
    camera = Camera.from_focal(30.0, 32, 24)
    usual = develop(color, Shot(camera, np.eye(4)), rng)
    dim = develop(color * 100, Shot(camera, np.eye(4), exposure=-1.0), rng)
    noisy = develop(color, Shot(camera, np.eye(4), noise=0.05), rng)
    assert usual.mean() == pytest.approx(255 * 0.49, abs=8)
    assert np.abs(develop(color * 100, Shot(camera, np.eye(4)), rng).astype(int) - usual).max() <= 1
    assert dim.mean() < 0.8 * usual.mean()
    assert 5 < np.std(noisy.astype(int) - usual) < 12
