"""One self-contained HTML page about the errors of a split; it needs no network and no other file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from multicam import __version__
from multicam.evaluation.points import PointSets
from multicam.evaluation.report import Table
from multicam.evaluation.split_error import SplitErrors
from multicam.evaluation.split_report import split_statements, stated_poses
from multicam.files import write_text
from multicam.progress import Progress
from multicam.visualization.evaluation_charts import accuracy_chart, bins_chart, calibration_chart
from multicam.visualization.overlay import to_hex
from multicam.visualization.pictures import data_uri, encode_jpeg
from multicam.visualization.templating import filled
from multicam.visualization.worst_cases import ESTIMATED_COLOR, TRUE_COLOR, WorstCase, choose_worst, draw_case

SHOWN_WIDTH = 480
"""Pixels of the pictures in the page."""


def write_evaluation_page(
    path: Path, errors: SplitErrors, tables: Sequence[Table], subtitle: Sequence[str], progress: Progress
) -> None:
    """Writes the page.

    Args:
        tables: as `split_tables` gives them.
        subtitle: lines on where the estimates and the pictures came from.

    Raises:
        DataError: a picture or a mesh cannot be read.
    """
    by_title = {table.title: table for table in tables}
    bins = [by_title[title] for title in ("By distance", "By visibility") if title in by_title]
    facts, warnings = split_statements(errors)
    worst = choose_worst(errors.poses, errors.catalogue)
    mesh_of = PointSets(errors.catalogue).mesh
    cases = [draw_case(error, errors.catalogue, mesh_of) for error in progress.track(worst, "drawing", len(worst))]
    calibration = None
    if errors.network is not None:
        keypoints = [e for found in errors.network.keypoints.values() for e in found]
        calibration = data_uri(calibration_chart(keypoints, stated_poses(errors), errors.catalogue), "svg+xml")
    page = filled(
        "evaluation.html",
        title="Object poses against ground truth",
        subtitle=subtitle,
        version=__version__,
        facts=facts,
        warnings=warnings,
        tables={title: table.to_html() for title, table in by_title.items()},
        accuracy=data_uri(accuracy_chart(errors.poses, errors.catalogue), "svg+xml"),
        bins=data_uri(bins_chart(bins), "svg+xml"),
        calibration=calibration,
        cases=[(_picture(case), case.title, case.text) for case in cases],
        colors=(to_hex(TRUE_COLOR), to_hex(ESTIMATED_COLOR)),
    )
    write_text(path, page)


def _picture(case: WorstCase) -> str:
    scale = SHOWN_WIDTH / case.picture.shape[1]
    small = cv2.resize(case.picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return data_uri(encode_jpeg(small.astype(np.uint8, copy=False)), "jpeg")
