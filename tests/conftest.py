"""Fixtures that every test may use."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from multicam.dataset.objects import Catalogue
from multicam.dataset.sequence import Recording
from tests.toy_objects import toy_catalogue
from tests.toy_recording import write_toy_recording

# Runs are alike by default; `pytest --hypothesis-profile=explore` hunts for new examples.
settings.register_profile(
    "ci",
    max_examples=50,
    derandomize=True,
    deadline=None,
    database=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("explore", settings.get_profile("ci"), derandomize=False, max_examples=1000)
settings.load_profile("ci")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skips tests marked `blender` where Blender's Python module is not installed."""
    if item.get_closest_marker("blender") and importlib.util.find_spec("bpy") is None:
        pytest.skip("bpy is not installed")


@pytest.fixture(scope="session")
def bench_dir() -> Path:
    """The folder of real published data: $MULTICAM_BENCH, or ../shared/bench beside the checkout."""
    default = Path(__file__).resolve().parents[2] / "shared" / "bench"
    folder = Path(os.environ.get("MULTICAM_BENCH", default))
    if not folder.is_dir():
        pytest.skip(f"real data is not there: {folder} (set MULTICAM_BENCH)")
    return folder


@pytest.fixture(scope="session")
def catalogue() -> Catalogue:
    """Six invented objects with every kind of symmetry."""
    return toy_catalogue()


@pytest.fixture(scope="session")
def toy_recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A slow walk of six steps between two tables as a recording on disk; do not change its files."""
    return write_toy_recording(tmp_path_factory.mktemp("recording"))


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed, new for each test."""
    return np.random.default_rng(0)
