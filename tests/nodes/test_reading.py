"""A log is read beside the work on it: by another process what a thread reads, and what goes wrong there is told."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twin_node.bag import BagError, LogWriter
from twin_node.nodes import reading
from twin_node.nodes.bridge import Bridge
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.reading import Finished, Order, Reading
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.nodes.topics import JOINT_STATES, GraphError
from twin_node.runtime.clock import PacedClock
from twin_node.runtime.worker_process import WorkerProcess
from twin_node.scene import FrameSet

SECONDS = 0.6
NARROW = SynchronizerParameters(width=80)
PACE = 0.25
"""Of the log's time: a machine that is held up for a moment does not make a set late."""
WAIT_S = 60.0
both_ways = pytest.mark.parametrize("own_process", [True, False])


@pytest.fixture
def session(cell_log: Callable[..., Path]) -> Iterator[LogSession]:
    with LogSession(cell_log(SECONDS)) as opened:
        yield opened


@dataclass
class Heard:
    """All that is read of a session."""

    sets: list[FrameSet] = field(default_factory=list)
    messages: list[tuple[str, Any]] = field(default_factory=list)
    finished: Finished = field(default_factory=Finished)


def listen(session: LogSession) -> Heard:
    """Reads a session to its end."""
    heard, bridge = Heard(), Bridge(lambda _: None)

    def take(frames: FrameSet) -> None:
        heard.sets.append(frames)
        bridge.put_frames(frames)

    with contextlib.closing(Reading(Order(session, NARROW))) as one:
        one.start(PacedClock(session.span.start_ns, PACE), bridge, take)
        for messages, _ in bridge.batches():
            heard.messages += messages
        heard.finished = one.finished
    return heard


@both_ways
def test_all_of_a_log_is_read(own_process: bool, session: LogSession, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "is_worth_it", lambda: own_process)
    heard, given = listen(session), list(LogSource(session, NARROW))
    assert [one.stamp for one in heard.sets] == [one.stamp for one in given]
    for ours, theirs in zip(heard.sets, given, strict=True):
        assert ours.joints is not None and theirs.joints is not None
        np.testing.assert_array_equal(ours.joints.positions, theirs.joints.positions)
        for a, b in zip(ours.views, theirs.views, strict=True):
            assert a.camera.sees_as(b.camera)
            np.testing.assert_array_equal(a.rgb, b.rgb)
            np.testing.assert_array_equal(a.depth, b.depth)
    first, *later = heard.sets
    assert all(a.camera is b.camera for one in later for a, b in zip(first.views, one.views, strict=True))
    before_the_last_set = [
        one for one in session.log.messages([JOINT_STATES]) if one.stamp < heard.sets[-1].stamp - 50_000_000
    ]
    told = [message for topic, message in heard.messages if topic == JOINT_STATES]
    assert len(told) >= len(before_the_last_set) > 20
    np.testing.assert_array_equal(told[5].position, before_the_last_set[5].message.position)
    assert heard.finished.damage is None
    assert (20 < heard.finished.peak_rss_mb < 200) if own_process else heard.finished.peak_rss_mb == 0


@both_ways
def test_what_is_wrong_with_a_log_is_told(
    own_process: bool, cell_log: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "is_worth_it", lambda: own_process)
    swapped = tmp_path / "swapped.mcap"
    with LogSession(cell_log(SECONDS)) as whole, LogWriter(swapped) as log:
        messages = list(whole.log.messages())
        data = [one.data for one in messages]
        images = [i for i, one in enumerate(messages) if one.topic == "/cam_left/image_raw/compressed"]
        early, late = images[3], images[9]
        data[early], data[late] = data[late], data[early]
        for one, its in zip(messages, data, strict=True):
            log.write_raw(one.topic, one.msgtype, its, one.stamp)
    with LogSession(swapped) as session, pytest.raises(GraphError, match="'cam_left': image stamps run backwards"):
        listen(session)


def test_a_log_that_is_gone_is_told_before_anything_is_read(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    copy = shutil.copy(cell_log(SECONDS), tmp_path / "copy.mcap")
    with LogSession(Path(copy)) as session:
        Path(copy).unlink()
        with pytest.raises(BagError, match=r"copy\.mcap"):
            listen(session)


@both_ways
def test_reading_ends_when_nobody_listens_any_more(
    own_process: bool, session: LogSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "is_worth_it", lambda: own_process)
    bridge = Bridge(lambda _: None)
    with contextlib.closing(Reading(Order(session, NARROW))) as one:
        one.start(PacedClock(session.span.start_ns, 0.5), bridge, bridge.put_frames)
        next(bridge.batches())
        bridge.close()
    assert not any(thread.name == "reader" for thread in threading.enumerate())
    assert one.finished == Finished()


class Asked(Bridge):
    """Tells when it has said whether it is closed."""

    def __init__(self) -> None:
        super().__init__(lambda _: None)
        self.has_said = threading.Event()

    @property
    def is_closed(self) -> bool:
        closed = super().is_closed
        self.has_said.set()
        return closed


def test_a_thread_that_waits_for_a_log_with_nothing_to_say_for_hours_ends(
    session: LogSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "is_worth_it", lambda: False)
    bridge, one = Asked(), Reading(Order(session, NARROW))
    one.start(PacedClock(session.span.start_ns, 1e-9), bridge, bridge.put_frames)
    assert bridge.has_said.wait(WAIT_S)
    bridge.close()
    closing = threading.Thread(target=one.close, daemon=True)
    closing.start()
    closing.join(WAIT_S)
    assert not closing.is_alive()


def test_a_process_that_dies_is_told_of_in_one_line(session: LogSession, monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[WorkerProcess] = []

    def begin(*arguments: str) -> WorkerProcess:
        begun.append(WorkerProcess(*arguments))
        return begun[-1]

    monkeypatch.setattr(reading, "is_worth_it", lambda: True)
    monkeypatch.setattr(reading, "WorkerProcess", begin)
    bridge = Bridge(lambda _: None)
    with contextlib.closing(Reading(Order(session, NARROW))) as one:
        one.start(PacedClock(session.span.start_ns, 0.1), bridge, bridge.put_frames)
        next(bridge.batches())
        os.kill(begun[0].pid, signal.SIGKILL)
        with pytest.raises(GraphError, match=r"reader: expected its process \(\d+\) to go on, .* with status -9"):
            list(bridge.batches())
