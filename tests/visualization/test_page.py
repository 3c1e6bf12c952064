import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from multicam.dataset.bop_reader import read_image
from multicam.errors import DataError
from multicam.evaluation.run_error import evaluate_run
from multicam.progress import SilentProgress
from multicam.visualization.page import write_page
from multicam.visualization.pictures import overlay_path, write_overlays
from tests.toy_recording import truthful_run
from tests.toy_walk import HEADSET, LEFT, RIGHT


class Balance(HTMLParser):
    """Fails on tags that do not close; collects the tags used."""

    VOID = frozenset({"meta", "img", "input", "br"})

    def __init__(self):
        super().__init__()
        self.open, self.used = [], set()

    def handle_starttag(self, tag, attrs):
        self.used.add(tag)
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def drawn(toy_recording, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    run = truthful_run(toy_recording, placed_from=2)
    write_overlays(folder, run, toy_recording, {}, SilentProgress())
    return folder, run


def test_every_picture_of_every_step_gets_an_overlay(drawn):
    folder, run = drawn
    for step in range(len(run.steps)):
        for name in (HEADSET, LEFT, RIGHT):
            assert read_image(overlay_path(folder, name, step)).shape == (480, 640, 3)


def test_the_page_stands_alone_and_says_what_is_not_known(drawn, toy_recording):
    folder, run = drawn
    text = write_page(folder, run, toy_recording, None, ["Recording X"], SilentProgress()).read_text()
    assert "Not judged yet" in text
    assert "Camera errors</caption>" not in text
    outside = re.findall(r'(?:src|href)="(?!data:)[^"]*"|https?://(?!www\.w3\.org)[^"\s]+', text)
    assert outside == []
    parser = Balance()
    parser.feed(text)
    assert parser.open == []
    assert (folder / "top_view.png").is_file()


def test_the_judged_page_shows_errors_reasons_and_coverage(drawn, toy_recording):
    folder, run = drawn
    errors = evaluate_run(run, {}, toy_recording, SilentProgress())
    text = write_page(folder, run, toy_recording, errors, [], SilentProgress()).read_text()
    assert "<caption>Camera errors</caption>" in text
    assert f"{LEFT} in {HEADSET}" in text
    assert "step 1: not placed, nothing in common" in text
    assert f"{LEFT}: nothing in common (5)" in text


def test_names_from_files_cannot_inject_markup(drawn, toy_recording):
    folder, run = drawn
    text = write_page(folder, run, toy_recording, None, ["<script>alert(1)</script>"], SilentProgress()).read_text()
    assert "<script>alert(1)" not in text


def test_warnings_stand_on_the_page(drawn, toy_recording):
    folder, run = drawn
    broken = replace(run, complete=False)
    text = write_page(folder, broken, toy_recording, None, [], SilentProgress()).read_text()
    assert "The run was interrupted" in text


def test_a_missing_overlay_is_named(drawn, toy_recording, tmp_path):
    _, run = drawn
    with pytest.raises(DataError, match=r"overlays.* does not exist"):
        write_page(tmp_path, run, toy_recording, None, [], SilentProgress())
