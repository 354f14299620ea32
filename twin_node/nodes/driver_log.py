"""The recording of a driver at work, which outlives its process and never ends the driver."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

from twin_node.bag import BagError, RecordingWriter
from twin_node.messages import Message, builtin_types, serialize
from twin_node.nodes.put_back import Arrivals, PutBackClock


class DriverLog:
    """Writes messages as they come; where the disk refuses it says so, once, and takes no more.

    An arm that stood because a disk is full would wait for somebody who knows nothing of disks. Where the clock is put
    back another recording is begun beside.
    """

    def __init__(self, path: Path, say: Callable[[str], None]) -> None:
        """Raises `BagError` where nothing can be begun at `path`."""
        self._writers = [RecordingWriter(path)]
        self._arrivals, self._put_back = Arrivals(), PutBackClock(path, say)
        self._say = say
        self.error: BagError | None = None
        """Why it ended before its time; None: it did not."""

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics that messages were written of."""
        return tuple({topic: None for writer in self._writers for topic in writer.topics})

    def write(self, topic: str, message: Message, stamp_ns: int) -> None:
        """Writes a message at a log time in ns."""
        if self.error is not None:
            return
        try:
            if (beside := self._put_back.beside(self._arrivals.at(stamp_ns))) is not None:
                self._writers.append(self._writers[-1].followed_by(beside, stamp_ns))
            self._writers[-1].write(topic, message.__msgtype__, serialize(message), stamp_ns, builtin_types())
        except BagError as error:
            self.error = error
            self._say(f"not recorded any more: {error}; the driver goes on")
            with contextlib.suppress(BagError):  # its beginning stands; why it ended was told
                self._writers[-1].close()

    def close(self) -> None:
        """Finishes the recording. Raises why it ended before its time."""
        if self.error is None:
            self._writers[-1].close()
        else:
            raise self.error

    def discard(self) -> None:
        """Takes the recording away: it holds nothing that anybody wants."""
        for writer in self._writers:
            writer.discard()
