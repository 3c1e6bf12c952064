import sys
import urllib.request

import pytest

from multicam.errors import MissingDependencyError
from multicam.visualization.viewer import Viewer
from tests.toy_recording import truthful_run


def test_the_scene_is_served_on_localhost(toy_recording):
    pytest.importorskip("viser")
    viewer = Viewer(toy_recording.catalogue, port=18765)
    try:
        run = truthful_run(toy_recording)
        frames = next(iter(toy_recording.frame_sets())).frames
        for step in run.steps[:2]:
            viewer.show(step, frames)
        with urllib.request.urlopen(viewer.url, timeout=20) as answer:
            assert answer.status == 200
            assert b"<html" in answer.read().lower()
    finally:
        viewer.stop()


def test_a_missing_package_is_named(toy_recording, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingDependencyError, match=r"pip install \"multicam-pose\[view\]\""):
        Viewer(toy_recording.catalogue, port=18766)
