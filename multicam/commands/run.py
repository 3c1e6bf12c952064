"""`multicam run`: camera and object poses from a recording of several cameras."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from multicam import pipeline
from multicam.adjuster import Adjuster, load_bodies
from multicam.config import parse_command, save_config
from multicam.dataset.objects import Catalogue
from multicam.dataset.results import read_results, write_results
from multicam.dataset.runs import FrameIndex, RunResult, StepResult, write_run
from multicam.dataset.sequence import Recording, group_by_time, load_recording
from multicam.errors import ConfigError, DataError, ModelError
from multicam.evaluation.run_error import RunErrors
from multicam.evaluation.tables import statements
from multicam.fitting.config import FitConfig
from multicam.fitting.fitter import Fitter
from multicam.follower import FollowConfig, Follower
from multicam.inference.estimator import Estimator, EstimatorConfig, FrameEstimates
from multicam.inference.session import Network, SessionConfig
from multicam.pipeline import PipelineConfig
from multicam.progress import Progress, RichProgress
from multicam.types import Frame, ObjectEstimate
from multicam.visualization.page import write_page
from multicam.visualization.pictures import clear_overlays, write_overlays
from multicam.visualization.viewer import Viewer

RESULTS, ESTIMATES, CONFIG = "results.json", "estimates.csv", "config.yaml"
"""Files of a run's folder, beside overlays/, top_view.png and report.html."""

UNCERTAIN = "estimates_covariance.csv"
"""The same estimates with the covariance of each, which BOP's files do not hold."""

Estimate = Callable[[Sequence[Frame]], tuple[list[FrameEstimates], dict[str, float]]]
"""Frames of one step to the objects of each, and the seconds taken by stage."""


Watch = Callable[[StepResult, Sequence[Frame]], None]
"""Takes a finished step and its frames."""


@dataclass(frozen=True)
class RunConfig:
    """Places all cameras of a recording, step by step."""

    recording: Path = Path("data/sequence")
    """Folder with sequence.json, models/ and one BOP scene per camera."""
    network: Path = Path("runs/train/network.onnx")
    """Network file written by `multicam export`."""
    output: Path = Path("runs/run")
    """Folder for results.json, estimates.csv, estimates_covariance.csv, overlays and report.html; files of an earlier
    run are replaced."""
    tolerance_ms: float = 20.0
    """Pictures of different cameras that are closer in time than this make one step."""
    view: bool = False
    """Show the scene graph live in a browser, and keep showing the last step until Ctrl-C."""
    view_port: int = 8080
    """Port of the live view on this machine."""
    session: SessionConfig = field(default_factory=SessionConfig)
    """Where the network runs."""
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    """From pixels to object poses in one camera."""
    fit: FitConfig = field(default_factory=FitConfig)
    """The network's poses, brought to what depth shows in cameras that measure it."""
    follow: FollowConfig = field(default_factory=FollowConfig)
    """Steps at which the network need not look."""
    pipeline: PipelineConfig = field(default_factory=PipelineConfig)
    """From object poses in all cameras to camera poses over time."""

    def __post_init__(self) -> None:
        if self.tolerance_ms < 0:
            raise ConfigError(f"tolerance_ms is {self.tolerance_ms:g}; it must not be negative.")


def main(argv: list[str]) -> None:
    """Parses the flags, runs, and prints where the results are."""
    config = parse_command(RunConfig, argv, "multicam run", "Camera and object poses from a recording.")
    console = Console(highlight=False, markup=False, soft_wrap=True)
    viewer = Viewer(load_recording(config.recording).catalogue, config.view_port) if config.view else None
    try:
        result = run(config, RichProgress(), viewer.show if viewer else None)
        facts, warnings = statements(result, None, load_recording(config.recording).catalogue)
        for line in (*facts, *warnings):
            console.print(line)
        console.print(f"Report: {config.output / 'report.html'}")
        if viewer:
            console.print(f"Live view: {viewer.url} (Ctrl-C ends it)")
            with suppress(KeyboardInterrupt):
                threading.Event().wait()
    finally:
        if viewer:
            viewer.stop()


def run(config: RunConfig, progress: Progress, watch: Watch | None = None) -> RunResult:
    """Runs the network and the pipeline over a recording and writes the run's folder.

    Args:
        watch: called with every step as soon as it is done.

    Raises:
        DataError: the recording is missing, malformed, empty or has a damaged picture.
        ModelError: the network file is not ours, or knows other objects than the recording.
        KeyboardInterrupt: passed on after the results so far have been written.
    """
    recording = load_recording(config.recording)
    network = Network(config.network, config.session)
    catalogue = network.metadata.catalogue()
    check_objects(catalogue, recording.catalogue, recording.folder / "models", config.network)
    estimate = network_estimate(Estimator(network, config.estimator))
    return run_recording(recording, estimate, catalogue, config, progress, watch)


def run_recording(
    recording: Recording,
    estimate: Estimate,
    catalogue: Catalogue,
    config: RunConfig,
    progress: Progress,
    watch: Watch | None = None,
) -> RunResult:
    """The part of `run` after the network has been opened; `estimate` is the network or stands in for it."""
    steps = Steps(recording, estimate, catalogue, config, load_helpers(recording, config, progress))
    estimates = _Collected(recording)
    interrupted = False
    done: list[StepResult] = []
    try:
        for result, frames, found in progress.track(steps, "placing cameras", len(steps)):
            done.append(result)
            if watch is not None:
                watch(result, frames)
            estimates.add(frames, found, sum(result.seconds.values()))
    except KeyboardInterrupt:
        if not done:
            raise
        interrupted = True
    outcome = RunResult(
        config.recording.resolve(), config.network.resolve(), steps.headset, not interrupted, tuple(done)
    )
    clear_overlays(config.output)
    save_config(config, config.output / CONFIG)
    write_results(config.output / ESTIMATES, estimates.rows)
    write_results(config.output / UNCERTAIN, estimates.rows, covariances=True)
    write_run(config.output / RESULTS, outcome)
    if interrupted:
        raise KeyboardInterrupt
    write_report(config.output, outcome, recording, None, progress)
    return outcome


def write_report(
    folder: Path, outcome: RunResult, recording: Recording, errors: RunErrors | None, progress: Progress
) -> Path:
    """Writes overlays that are not there yet and the page of a run, before (None) or after its errors are known."""
    write_overlays(folder, outcome, recording, read_results(folder / ESTIMATES), progress)
    subtitle = [f"Recording {outcome.recording}", f"Network {outcome.network}"]
    return write_page(folder, outcome, recording, errors, subtitle, progress)


@dataclass(frozen=True, eq=False)
class Helpers:
    """What looks at pictures beside the network; None where it is left out.

    Attributes:
        adjuster: bundle adjustment of cameras and objects.
        fitter: brings single estimates to measured depth.
        follower: stands in for the network.
    """

    adjuster: Adjuster | None
    fitter: Fitter | None
    follower: Follower | None


class Steps:
    """The steps of a recording, computed one by one as they are asked for; no more than one is in memory."""

    def __init__(
        self,
        recording: Recording,
        estimate: Estimate,
        catalogue: Catalogue,
        config: RunConfig,
        helpers: Helpers,
    ) -> None:
        """Looks at the cameras.

        Raises:
            DataError: no pictures, or not exactly one moving camera.
        """
        moving = [c.camera_id for c in recording.cameras if c.moving]
        if len(moving) != 1:
            raise DataError(
                f"{recording.folder} has {len(moving)} moving cameras ({', '.join(moving) or 'none'}); exactly one, "
                "the headset, must be moving and tracked, for its tracking defines the world."
            )
        self.headset = moving[0]
        self._tolerance_ns = round(config.tolerance_ms * 1e6)
        self._count = len(group_by_time(recording.cameras, self._tolerance_ns))
        if self._count == 0:
            raise DataError(f"{recording.folder} holds no pictures: its sequence.json lists no frames.")
        self._recording, self._estimate = recording, estimate
        self._catalogue, self._config = catalogue, config
        self._helpers = helpers

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[tuple[StepResult, tuple[Frame, ...], list[tuple[ObjectEstimate, ...]]]]:
        statics = [c.camera_id for c in self._recording.cameras if not c.moving]
        graph = pipeline.start(self.headset, statics, self._config.pipeline)
        adjuster, follower = self._helpers.adjuster, self._helpers.follower
        for frame_set in self._recording.frame_sets(self._tolerance_ns):
            frames = frame_set.frames
            found, seconds, detected = self._look(frames)
            graph, result = pipeline.step(graph, frame_set, found, self._catalogue, self._config.pipeline, adjuster)
            if follower is not None:
                began = time.perf_counter()
                follower.learn(frames, result, detected)
                seconds["follow"] += time.perf_counter() - began
            yield result.with_seconds(**seconds), frames, found

    def _look(self, frames: Sequence[Frame]) -> tuple[list[tuple[ObjectEstimate, ...]], dict[str, float], bool]:
        """The objects of each frame, the seconds it took by stage, and whether the network was asked."""
        seconds: dict[str, float] = {}
        if self._helpers.follower is not None:
            began = time.perf_counter()
            followed = self._helpers.follower.look(frames)
            seconds["follow"] = time.perf_counter() - began
            if followed is not None:
                return followed, seconds, False
        found, took = self._estimate(frames)
        if self._helpers.fitter is None:
            return [each.estimates for each in found], took | seconds, True
        began = time.perf_counter()
        fitted = self._helpers.fitter.fit(frames, found)
        seconds["fit"] = time.perf_counter() - began
        return fitted, took | seconds, True


def load_helpers(recording: Recording, config: RunConfig, progress: Progress) -> Helpers:
    """What a run of a recording needs.

    Raises:
        DataError: a mesh cannot be read, or the viewpoint models cannot be kept.
    """
    bundle, depth = config.pipeline.bundle, recording.measures_depth
    adjusts = bundle.enabled and (bundle.without_depth or depth)
    fits, follows = config.fit.enabled and depth, config.follow.every > 1
    bodies = load_bodies(recording.catalogue, bundle.viewpoints, progress) if adjusts or fits or follows else {}
    return Helpers(
        Adjuster(bodies, bundle) if adjusts else None,
        Fitter(bodies, recording.catalogue, config.fit) if fits else None,
        Follower(bodies, config.follow) if follows else None,
    )


class _Collected:
    """Rows of the BOP results file; the frames themselves are let go."""

    def __init__(self, recording: Recording) -> None:
        self._index = FrameIndex(recording)
        self.rows: list[tuple[int, int, ObjectEstimate, float]] = []

    def add(self, frames: Sequence[Frame], found: Sequence[tuple[ObjectEstimate, ...]], seconds: float) -> None:
        for frame, estimates in zip(frames, found, strict=True):
            camera, entry = self._index.find(frame.camera_id, frame.timestamp_ns)
            self.rows += [(camera.scene_id, entry.im_id, estimate, seconds) for estimate in estimates]


def network_estimate(estimator: Estimator) -> Estimate:
    """The estimator with its time split into network and PnP."""

    def estimate(frames: Sequence[Frame]) -> tuple[list[FrameEstimates], dict[str, float]]:
        began = time.perf_counter()
        detections = estimator.network.detect([frame.image for frame in frames], estimator.config.decode)
        detected = time.perf_counter()
        found = [estimator.solve(d, frame.camera) for d, frame in zip(detections, frames, strict=True)]
        return found, {"network": detected - began, "pnp": time.perf_counter() - detected}

    return estimate


def check_objects(known: Catalogue, catalogue: Catalogue, models: Path, network: Path) -> None:
    """Compares a network's classes with the objects of a data set.

    Args:
        known: the network's; catalogue: the data set's; models, network: where they come from.

    Raises:
        ModelError: the data set lacks a class of the network, or has another object under its number.
    """
    for model in known.objects.values():
        if model.obj_id not in catalogue:
            raise ModelError(
                f"{network} knows object {model.obj_id} ({model.name}), which {models} lacks: "
                "run it on pictures of the objects it was trained on."
            )
        other = catalogue[model.obj_id]
        if not 0.95 < other.diameter / model.diameter < 1.05:
            raise ModelError(
                f"object {model.obj_id} is {model.name}, {model.diameter * 1000:.0f} mm across, in {network} but "
                f"{other.name}, {other.diameter * 1000:.0f} mm, in {models}."
            )
