"""Estimates, or a network's answers, against the truth of a split: figures, tables and a page."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from multicam.commands.run import check_objects
from multicam.dataset.bop_reader import ImageRecord, read_image
from multicam.dataset.objects import Catalogue
from multicam.dataset.results import Estimates
from multicam.errors import ConfigError
from multicam.evaluation.report import render_text, save_report
from multicam.evaluation.single_view import camera_of
from multicam.evaluation.split_error import NetworkAnswers, SplitErrors
from multicam.evaluation.split_report import split_statements, split_tables
from multicam.inference.estimator import Estimator, EstimatorConfig
from multicam.inference.session import Network, SessionConfig
from multicam.progress import Progress
from multicam.spread import spread
from multicam.types import Detection, ObjectEstimate
from multicam.visualization.evaluation_page import write_evaluation_page

PAGE, REPORT = "evaluation.html", "evaluation"
"""The page, and the stem of text, JSON and CSV."""

ALL_SCORES = 0.01
"""Detections are kept from this score on, so that average precision sees how the network ranks the weak ones."""

BATCH = 8
"""Images that go through the network together."""

Row = tuple[int, int, ObjectEstimate, float]
"""Scene, image, estimate and seconds, as a results file has them."""


def limited(records: Sequence[ImageRecord], limit: int | None) -> list[ImageRecord]:
    """At most `limit` images, evenly over the split.

    Raises:
        ConfigError: the limit is not positive.
    """
    if limit is not None and limit < 1:
        raise ConfigError(f"--limit is {limit}; at least one image must be judged.")
    return list(records) if limit is None else spread(records, limit)


def ask_network(
    path: Path,
    session: SessionConfig,
    config: EstimatorConfig,
    records: Sequence[ImageRecord],
    catalogue: Catalogue,
    models: Path,
    progress: Progress,
) -> tuple[list[Row], NetworkAnswers]:
    """Runs a network and PnP on images.

    Returns:
        Poses of the detections that are believed, and all detections.

    Raises:
        ModelError: not a network of ours, or one for other objects.
        DataError: an image cannot be read or lacks its cam_K.
    """
    network = Network(path, session)
    objects, least_score = network.metadata.catalogue(), config.decode.score_threshold
    check_objects(objects, catalogue, models, path)
    estimator = Estimator(network, config)
    every_score = replace(config.decode, score_threshold=min(ALL_SCORES, least_score))
    rows: list[Row] = []
    detections: dict[tuple[int, int], list[Detection]] = {}
    batches = [records[start : start + BATCH] for start in range(0, len(records), BATCH)]
    for batch in progress.track(batches, "running the network", len(batches)):
        cameras = [camera_of(record) for record in batch]
        images = [read_image(record.rgb_path) for record in batch if record.rgb_path is not None]
        began = time.perf_counter()
        found = network.detect(images, every_score)
        believed = [[d for d in own if d.score >= least_score] for own in found]
        poses = [estimator.solve(own, camera).estimates for own, camera in zip(believed, cameras, strict=True)]
        seconds = (time.perf_counter() - began) / len(batch)
        for record, own, estimates in zip(batch, found, poses, strict=True):
            detections[record.scene_id, record.im_id] = own
            rows += [(record.scene_id, record.im_id, estimate, seconds) for estimate in estimates]
    return rows, NetworkAnswers(detections, objects, least_score)


def by_image(rows: Sequence[Row]) -> Estimates:
    """Rows of a results file as reading that file would give them, covariances and keypoints kept."""
    estimates: Estimates = {}
    for scene_id, im_id, estimate, _ in rows:
        estimates.setdefault((scene_id, im_id), []).append(estimate)
    return estimates


def report_split(folder: Path, errors: SplitErrors, subtitle: Sequence[str], progress: Progress) -> str:
    """Writes tables as text, JSON and CSV, and the page.

    Returns:
        Tables and statements as text.
    """
    tables = split_tables(errors)
    facts, warnings = split_statements(errors)
    save_report(folder, REPORT, tables)
    write_evaluation_page(folder / PAGE, errors, tables, subtitle, progress)
    return render_text(tables) + "\n" + "\n".join([*facts, *(f"Warning: {text}" for text in warnings)])
