"""Recordings run with a network at every step, and at some steps with objects followed in between.

    python benchmarks/bundle_follow.py RECORDING [RECORDING ...] [--every 1 3 5 10]

The network is stood in for: where it is asked, it answers with true poses and the noise of estimates that state none
(an outline 2.5 pixels off, depth four times worse). Following knows nothing of the truth. Errors are those of static
cameras in the headset's frame at each step, as `multicam evaluate --run` has them.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from bundle_rigs import VISIBLE, estimates_of
from registration import machine
from rich.console import Console
from rich.table import Table

from multicam.commands.run import Estimate, RunConfig, Steps, load_helpers
from multicam.dataset.sequence import Recording, load_recording
from multicam.evaluation.camera_error import camera_error
from multicam.evaluation.truth import Truth
from multicam.fitting.config import FitConfig
from multicam.follower import FollowConfig
from multicam.geometry import se3
from multicam.inference.estimator import FrameEstimates
from multicam.progress import RichProgress
from multicam.types import Frame, ObjectEstimate


def stand_in(recording: Recording) -> Estimate:
    """Answers in the place of a network: true poses with noise."""
    truth, rng = Truth(recording), np.random.default_rng(0)

    def estimate(frames: Sequence[Frame]) -> tuple[list[FrameEstimates], dict[str, float]]:
        found: list[FrameEstimates] = []
        for frame in frames:
            record = truth.record(frame.camera_id, frame.timestamp_ns)
            seen = [i for i in record.instances if (i.visible_fraction or 0) >= VISIBLE]
            corners = np.array([recording.catalogue[i.obj_id].box_corners() for i in seen]).reshape(-1, 8, 3)
            exact = np.array([i.camera_from_object for i in seen]).reshape(-1, 4, 4)
            focal = np.full(len(seen), frame.camera.matrix[0, 0])
            poses, covariance = estimates_of(exact, corners, focal, rng)
            estimates = tuple(
                ObjectEstimate(i.obj_id, 0.9, pose, each) for i, pose, each in zip(seen, poses, covariance, strict=True)
            )
            found.append(FrameEstimates(estimates, ()))
        return found, {"network": 0.0, "pnp": 0.0}

    return estimate


def counted(estimate: Estimate, asked: list[int]) -> Estimate:
    """The same, noting each question."""

    def ask(frames: Sequence[Frame]) -> tuple[list[FrameEstimates], dict[str, float]]:
        asked.append(len(frames))
        return estimate(frames)

    return ask


def walk(recording: Recording, config: RunConfig) -> tuple[float, list[float], list[float], int]:
    """Share of steps with the network, errors (mm), milliseconds of following, poses that were missing."""
    asked: list[int] = []
    helpers = load_helpers(recording, config, RichProgress())
    steps = Steps(recording, counted(stand_in(recording), asked), recording.catalogue, config, helpers)
    known = Truth(recording)
    errors, times, missing = [], [], 0
    for result, frames, _ in steps:
        truth = {frame.camera_id: known.camera(frame.camera_id, frame.timestamp_ns) for frame in frames}
        headset = result.camera(steps.headset).world_from_camera
        times.append(1e3 * result.seconds.get("follow", 0.0))
        for name in truth.keys() - {steps.headset}:
            pose = result.camera(name).world_from_camera
            if headset is None or pose is None or steps.headset not in truth:
                missing += 1
                continue
            found, true = (se3.inverse(a) @ b for a, b in ((headset, pose), (truth[steps.headset], truth[name])))
            errors.append(camera_error(found, true).centre_mm)
    return len(asked) / len(times), errors, times, missing


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path, nargs="+")
    parser.add_argument("--every", type=int, nargs="+", default=[1, 3, 5, 10])
    options = parser.parse_args()
    print(machine())
    table = Table(
        "adjusted", "every", "network asked %", "mean mm", "median", "p90", "missing", "following ms", "p90 ms"
    )
    recordings = [load_recording(folder) for folder in options.recordings]
    for adjusted in (False, True):
        for every in options.every:
            table.add_row("yes" if adjusted else "no", str(every), *row(recordings, adjusted, every))
    Console(width=140).print(table)


def row(recordings: Sequence[Recording], adjusted: bool, every: int) -> list[str]:
    """Figures over all recordings."""
    # Without fits, which would hide what following loses.
    base = RunConfig(output=Path(tempfile.gettempdir()), fit=FitConfig(enabled=False), follow=FollowConfig(every=every))
    bundle = replace(base.pipeline.bundle, enabled=adjusted)
    config = replace(base, pipeline=replace(base.pipeline, bundle=bundle))
    walks = [walk(each, config) for each in recordings]
    errors, times = (np.concatenate([each[k] for each in walks]) for k in (1, 2))
    followed = times[times > 0] if every > 1 else np.zeros(1)
    figures = (errors.mean(), np.median(errors), np.percentile(errors, 90))
    return [
        f"{100 * np.mean([each[0] for each in walks]):.0f}",
        *(f"{x:.1f}" for x in figures),
        str(sum(each[3] for each in walks)),
        f"{np.median(followed):.0f}",
        f"{np.percentile(followed, 90):.0f}",
    ]


if __name__ == "__main__":
    main()
