"""Plays a log for whoever works on it, in a process of its own where there is a processor for it, else in a thread."""

from __future__ import annotations

import contextlib
import pickle
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, cast

from twin_node.bag.qos import is_latched
from twin_node.nodes.bridge import Bridge
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.nodes.topics import FRAMES, OF_THE_ARM, GraphError
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import PacedClock, SteppedClock
from twin_node.runtime.worker_process import EndedError, WorkerProcess, is_worth_it
from twin_node.scene import Camera, FrameSet

LONGEST_WAIT_S = 0.1
"""How long a thread that waits for its log's next message may take to notice that nobody listens any more, s."""

OnFrames = Callable[[FrameSet], None]
OnMessage = Callable[[str, Any], None]


@dataclass(frozen=True)
class Order:
    """What is read."""

    session: LogSession
    synchronizer: SynchronizerParameters
    joint_names: tuple[str, ...] = ()
    """See `SynchronizerNode`."""


@dataclass(frozen=True)
class Finished:
    """What there is to say when all is read."""

    damage: str | None = None
    """Where the log could not be read on; None: it was read to its end."""
    damaged_images: tuple[str, ...] = ()
    """A line for each camera some of whose images were left out."""
    damaged_counts: Mapping[str, int] = field(default_factory=dict)
    """How many these were, by the cameras' names."""
    peak_rss_mb: float = 0.0
    """Most memory that a process of its own has held, MB."""


class Play:
    """Plays a session's span at a clock's pace, grouped into sets."""

    def __init__(
        self, order: Order, clock: SteppedClock | PacedClock, on_frames: OnFrames, on_message: OnMessage
    ) -> None:
        self._session, self._clock, self._bus = order.session, clock, LocalBus(is_latched)
        self._synchronizer = self._session.synchronizer(self._bus, clock, order.synchronizer, order.joint_names)
        self._synchronizer.configure()
        self._synchronizer.activate()
        self._bus.subscribe(FRAMES, on_frames)
        for topic in OF_THE_ARM:
            self._bus.subscribe(topic, partial(on_message, topic))

    def steps(self) -> Iterator[int]:
        """The log time, ns, after each message, and while the next is long in coming."""
        return self._session.player(self._bus).steps(self._clock, LONGEST_WAIT_S)

    def finished(self, peak_rss_mb: float = 0.0) -> Finished:
        """What there is to say of it, in a process of its own with the memory that this has held, MB."""
        damaged = self._synchronizer.damaged
        return Finished(self._session.log.damage, damaged.lines, damaged.counts, peak_rss_mb)


class Reading:
    """Reads a log once. A process takes a second to load: make this before anything else is done, and close it."""

    def __init__(self, order: Order) -> None:
        self._order = order
        self._process: WorkerProcess | None = None
        self._thread: threading.Thread | None = None
        self.finished = Finished()
        """What was said in the end."""
        if is_worth_it():
            self._process = WorkerProcess("twin_node.nodes.reading_process", "reader", "give it more memory")
            with _ended_is_told():
                self._process.send(order)

    def start(self, clock: PacedClock, bridge: Bridge, on_frames: OnFrames) -> None:
        """Starts the clock, and reads: a thread gives each set to `on_frames`, and to the bridge all else.

        In the end it closes the bridge. Raises what has kept the process from opening the log, and here or through the
        bridge `GraphError` where it has ended by itself.
        """
        process = self._process
        if process is not None:
            with _ended_is_told():
                process.is_loaded(wait=True)
        clock.start()
        if process is None:
            work = partial(self._read, clock, bridge, on_frames)
        else:
            with _ended_is_told():
                process.send(clock)
            work = partial(self._listen, process, bridge, on_frames)
        self._thread = threading.Thread(target=_closing, args=(work, bridge), name="reader", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the reading; in a thread only a closed bridge does."""
        if self._process is not None:
            self._process.end()
        if self._thread is not None:
            self._thread.join()
        if self._process is not None:
            self._process.close()

    def _read(self, clock: PacedClock, bridge: Bridge, on_frames: OnFrames) -> None:
        play = Play(self._order, clock, on_frames, bridge.put)
        for _ in play.steps():
            if bridge.is_closed:
                return
        self.finished = play.finished()

    def _listen(self, process: WorkerProcess, bridge: Bridge, on_frames: OnFrames) -> None:
        cameras = LogSource(self._order.session, self._order.synchronizer).cameras
        knowing = partial(KnowingCameras, cameras={camera.name: camera for camera in cameras})
        while not bridge.is_closed:
            with _ended_is_told():
                said = process.receive(knowing)
            if isinstance(said, Finished):
                self.finished = said
                return
            if isinstance(said, FrameSet):
                on_frames(said)
            else:
                topic, message = cast(tuple[str, Any], said)
                bridge.put(topic, message)


@contextlib.contextmanager
def _ended_is_told() -> Iterator[None]:
    try:
        yield
    except EndedError as error:
        raise GraphError(str(error)) from error


def _closing(work: Callable[[], None], bridge: Bridge) -> None:
    try:
        work()
    except BaseException as error:  # the working thread raises it, whatever it is
        bridge.close(error)
    else:
        bridge.close()


class NamingCameras(pickle.Pickler):
    """Copies in which cameras are but named: the other end has them."""

    def persistent_id(self, obj: object) -> str | None:
        """A camera's name."""
        return obj.name if isinstance(obj, Camera) else None


class KnowingCameras(pickle.Unpickler):
    """Reads what `NamingCameras` has written, with this end's cameras: what is found out for one is good for all its
    sets."""

    def __init__(self, *given: Any, cameras: Mapping[str, Camera], **named: Any) -> None:
        """`cameras` by their names; all else as `pickle.Unpickler` takes it."""
        super().__init__(*given, **named)
        self._cameras = cameras

    def persistent_load(self, pid: str) -> Camera:
        """The camera of a name."""
        return self._cameras[pid]
