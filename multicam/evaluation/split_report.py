"""Errors of a split as tables, and as plain sentences."""

from __future__ import annotations

import numpy as np

from multicam.evaluation.calibration import keypoint_shares, pose_shares, with_covariance
from multicam.evaluation.network_tables import SIGMAS, detection_table, keypoint_table, pose_calibration_table
from multicam.evaluation.recall import recall
from multicam.evaluation.report import Cell, Table
from multicam.evaluation.single_view import ObjectErrors
from multicam.evaluation.single_view_tables import (
    TENTH,
    add_table,
    distance_table,
    single_view_table,
    tenth_recall,
    visibility_table,
)
from multicam.evaluation.split_error import NetworkErrors, SplitErrors

FEW = 30
"""Objects of a class below which its figures are rough."""

WEAK = 0.5
"""Share of objects within a tenth of their diameter below which a network counts as weak."""


def split_tables(errors: SplitErrors) -> list[Table]:
    """All tables that apply."""
    poses, catalogue = errors.poses, errors.catalogue
    tables = [single_view_table(poses, catalogue), add_table(poses, catalogue), distance_table(poses, catalogue)]
    by_visibility = visibility_table(poses, catalogue)
    if by_visibility is not None:
        tables.append(by_visibility)
    if errors.network is not None:
        tables.append(detection_table(errors.network.detections, catalogue, errors.network.least_score))
        tables.append(keypoint_table(errors.network.keypoints, catalogue))
        tables.append(pose_calibration_table(poses, catalogue))
    return tables


def split_statements(errors: SplitErrors) -> tuple[list[str], list[str]]:
    """Plain sentences on what was reached, and warnings."""
    adds = {obj_id: [e.add_or_add_s for e in found] for obj_id, found in errors.poses.items()}
    count = sum(len(found) for found in adds.values())
    tenth = tenth_recall(adds, errors.catalogue)
    facts = [
        f"{count} objects in {errors.pictures} pictures were asked for: those {errors.selection.words()}.",
        f"{100 * tenth:.1f} % lie within a tenth of their diameter (ADD(-S), mean of classes).",
        _ar_sentence(single_view_table(errors.poses, errors.catalogue)),
    ]
    warnings: list[str] = []
    if tenth < WEAK:
        warnings.append("Fewer than half of the objects lie within a tenth of their diameter.")
    names = {obj_id: errors.catalogue[obj_id].name for obj_id in adds}
    lost = [names[i] for i, found in adds.items() if recall(found, TENTH * errors.catalogue[i].diameter) == 0]
    if lost:
        warnings.append(f"Not once within a tenth of the diameter: {', '.join(lost)}.")
    rough = [f"{names[i]} ({len(found)})" for i, found in adds.items() if len(found) < FEW]
    if rough:
        warnings.append(f"Too few objects for firm figures: {', '.join(rough)}.")
    if errors.network is not None:
        more_facts, more_warnings = _network_statements(errors, errors.network)
        facts, warnings = facts + more_facts, warnings + more_warnings
    return facts, warnings


def stated_poses(errors: SplitErrors) -> list[ObjectErrors]:
    """Of all classes, the errors of estimates that state a covariance."""
    return with_covariance(e for found in errors.poses.values() for e in found)


def _ar_sentence(table: Table) -> str:
    means: dict[str, Cell] = table.to_plain()["rows"][-1]
    if "AR %" in means:
        return f"BOP's average recall (VSD, MSSD, MSPD) is {means['AR %']:.1f} %."
    return f"Average recall of MSSD and MSPD is {means['AR without VSD %']:.1f} %; VSD needs depth images."


def _network_statements(errors: SplitErrors, network: NetworkErrors) -> tuple[list[str], list[str]]:
    facts: list[str] = []
    warnings: list[str] = []
    boxes = detection_table(network.detections, errors.catalogue, network.least_score).to_plain()["rows"][-1]
    facts.append(
        f"Boxes: AP {boxes['AP %']:.1f} %, AP50 {boxes['AP50 %']:.1f} %; at a score of {network.least_score:g}, "
        f"{boxes['recall %']:.0f} % of the objects are found."
    )
    keypoints = [e for found in network.keypoints.values() for e in found]
    if keypoints:
        pixels = float(np.median(np.concatenate([e.pixels for e in keypoints])))
        one = 100 * float(keypoint_shares(keypoints, SIGMAS[:1])[0])
        facts.append(
            f"Keypoints are {pixels:.1f} px off (median); {one:.0f} % of their coordinates lie within one standard "
            "deviation as stated, honest ones give 68 %."
        )
        if not 58 < one < 78:
            warnings.append(f"The stated standard deviations of keypoints are too {'small' if one < 68 else 'large'}.")
    poses = stated_poses(errors)
    if poses:
        inside = 100 * float(pose_shares(poses, errors.catalogue, np.array([0.95]))[0])
        facts.append(f"{inside:.0f} % of the poses have their truth in the 95 % ellipsoid they state.")
        if inside < 80:
            warnings.append(f"The stated uncertainties of poses are too small: {inside:.0f} % in their 95 % ellipsoid.")
    return facts, warnings
