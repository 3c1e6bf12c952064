"""A local worker process: reads the numbers of scenes from a pipe, and answers with events."""

from __future__ import annotations

import signal
import sys
from multiprocessing.connection import Connection
from types import FrameType

from datagen.jobs.work import SceneWorker


def serve(channel: Connection) -> None:
    """Works until the parent closes the pipe, or is gone."""
    config, threads = channel.recv()
    worker = SceneWorker(config, threads)
    try:
        while True:
            for event in worker.perform(channel.recv()):
                channel.send(event)
    except (EOFError, BrokenPipeError):
        return
    finally:
        worker.close()


def end_once(number: int, frame: FrameType | None) -> None:
    """Handler: ends the process; a second signal does not break into what the first has it put in order."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit(0)


def main() -> None:
    """Entry point; the pipe is the file descriptor given as the only argument."""
    # Ctrl-C reaches every process of a terminal; what becomes of the workers is for the parent to say.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, end_once)
    serve(Connection(int(sys.argv[1])))


if __name__ == "__main__":
    main()
