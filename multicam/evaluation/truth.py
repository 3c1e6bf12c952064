"""True poses of a recording, for evaluation."""

from __future__ import annotations

from multicam.dataset.bop_reader import ImageRecord
from multicam.dataset.runs import FrameIndex
from multicam.dataset.sequence import Recording
from multicam.evaluation.selection import ASKED
from multicam.types import FloatArray


class Truth:
    """True poses of a recording by camera and time stamp."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._index = FrameIndex(recording)

    def camera(self, camera_id: str, timestamp_ns: int) -> FloatArray:
        """True world_from_camera of a picture.

        Raises:
            DataError: the recording has no such picture or no truth.
        """
        _, entry = self._index.find(camera_id, timestamp_ns)
        return self._recording.truth_of(camera_id, entry.im_id)

    def static(self, camera_id: str, timestamp_ns: int) -> FloatArray:
        """True world_from_camera of a static camera at a time: that of its latest picture, for it may be bumped."""
        frames = next(c for c in self._recording.cameras if c.camera_id == camera_id).frames
        latest = next((e for e in reversed(frames) if e.timestamp_ns <= timestamp_ns), frames[0])
        return self._recording.truth_of(camera_id, latest.im_id)

    def record(self, camera_id: str, timestamp_ns: int) -> ImageRecord:
        """The BOP record of a picture."""
        _, entry = self._index.find(camera_id, timestamp_ns)
        return self._recording.record(camera_id, entry.im_id)

    def objects(self, camera_id: str, timestamp_ns: int) -> list[tuple[int, FloatArray]]:
        """(class, true world_from_object) of what a picture shows well enough."""
        record = self.record(camera_id, timestamp_ns)
        world_from_camera = self.camera(camera_id, timestamp_ns)
        return [(i.obj_id, world_from_camera @ i.camera_from_object) for i in record.instances if ASKED.takes(i)]
