"""Keeps what a run saw and said on disk, within bounds, so that it can be scored afterwards without slowing the run."""

from __future__ import annotations

import pickle
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from queue import Queue

from twin_node.errors import TwinError
from twin_node.scene import FrameSet, Occupancy, TwinState

MAX_SETS = 600
"""Sets kept in all: 20 s at 30 Hz, about 0.5 GB on disk at 10,000 Gaussians."""
BLOCK_NS = 1_000_000_000
"""Longer runs are kept in blocks of one second, spread evenly: a forecast needs its truth 200 ms later."""
WAITING = 30
"""Ticks that may wait to be written: a second's, 20 MB at 10,000 Gaussians."""


class SpoolError(TwinError):
    """A run cannot be kept for its report."""


@dataclass(frozen=True)
class Tick:
    """One input set, and what the twin made of it; a dropped set has only its images."""

    frames: FrameSet
    state: TwinState | None = None
    occupancy: Occupancy | None = None
    published: int | None = None
    """When the cloud of `state` was out, ns of the run's clock; None in lockstep, where it has no time of its own."""
    is_after_gap: bool = False
    """Whether sets right before it were not kept."""

    @property
    def stamp(self) -> int:
        """The set's stamp, ns."""
        return self.frames.stamp


class Spool:
    """Ticks on disk, which a thread of its own writes; safe to fill from two threads."""

    def __init__(self, start_ns: int, stop_ns: int, rate_hz: float) -> None:
        """Expects sets at `rate_hz` over a span as long as the given one and keeps at most about `MAX_SETS` of them."""
        self._first_ns: int | None = None
        """Stamp of the first set that was told of."""
        blocks = max(1, int(MAX_SETS / max(rate_hz, 1.0)))
        self._period_ns = max(BLOCK_NS, (stop_ns - start_ns) // blocks)
        try:
            self._file = tempfile.TemporaryFile(prefix="twin_node_")  # noqa: SIM115 (lives as long as the spool)
        except OSError as error:
            raise _refused(error) from None
        self._places: list[tuple[int, int, tuple[int, ...]]] = []
        """Of every tick its stamp, where it begins, and how many bytes it and each of its arrays take there."""
        self._waiting: Queue[Tick | None] = Queue(WAITING)
        self._error: BaseException | None = None
        self._writer = threading.Thread(target=self._write, name="spool", daemon=True)
        self._writer.start()

    def __enter__(self) -> Spool:
        return self

    def __exit__(self, *_: object) -> None:
        self._waiting.put(None)
        self._writer.join()
        self._file.close()

    def __len__(self) -> int:
        self._settle()
        return len(self._places)

    @property
    def keeps_all(self) -> bool:
        """Whether the run is short enough for every set of it to be kept."""
        return self._period_ns <= BLOCK_NS

    def keeps(self, stamp: int) -> bool:
        """Whether a set with this stamp is among those kept; the first that is asked about is, and begins them.

        So all are held against the image that the model begins with, whatever clock images are stamped by.
        """
        return self._into(stamp) % self._period_ns < BLOCK_NS

    def add(self, tick: Tick) -> None:
        """Append a tick whose stamp `keeps`; raises what kept one before from being written."""
        if self._error is not None:
            raise self._error
        self._waiting.put(tick)

    def __iter__(self) -> Iterator[Tick]:
        """Ticks in the order of their stamps, read one at a time."""
        self._settle()
        before: int | None = None
        for stamp, offset, sizes in sorted(self._places):
            self._file.seek(offset)
            data, *arrays = [bytearray(self._file.read(size)) for size in sizes]
            tick = pickle.loads(data, buffers=arrays)
            block = self._into(stamp) // self._period_ns
            is_first = before is not None and block != before and self._period_ns > BLOCK_NS
            yield replace(tick, is_after_gap=True) if is_first else tick
            before = block

    def _into(self, stamp: int) -> int:
        """How long after the first set one of a stamp is, ns; 0 before it, as another thread may be."""
        if self._first_ns is None:
            self._first_ns = stamp
        return max(stamp - self._first_ns, 0)

    def _settle(self) -> None:
        """Waits until all ticks are written; raises what has kept one from being."""
        self._waiting.join()
        if self._error is not None:
            raise self._error

    def _write(self) -> None:
        """Writes ticks until there are no more; after an error they are let go, so that nobody waits for room."""
        while (tick := self._waiting.get()) is not None:
            try:
                if self._error is None:
                    self._append(tick)
            except OSError as error:
                self._error = _refused(error)
            except Exception as error:  # whoever adds or reads the next one raises it, whatever it is
                self._error = error
            finally:
                self._waiting.task_done()

    def _append(self, tick: Tick) -> None:
        """Arrays are written from where they lie: to copy them first would keep the threads of the run waiting."""
        arrays: list[pickle.PickleBuffer] = []
        data = pickle.dumps(tick, protocol=pickle.HIGHEST_PROTOCOL, buffer_callback=arrays.append)
        parts = [memoryview(data), *(array.raw() for array in arrays)]
        self._places.append((tick.stamp, self._file.seek(0, 2), tuple(part.nbytes for part in parts)))
        for part in parts:
            self._file.write(part)


def _refused(error: OSError) -> SpoolError:
    return SpoolError(
        f"{_folder()}: the run cannot be kept there for its report ({error.strerror}); free space, set TMPDIR, or "
        "leave out --report"
    )


def _folder() -> str:
    """Where temporary files go, for messages."""
    try:
        return tempfile.gettempdir()
    except OSError:  # nowhere takes any
        return "temporary files"
