"""A process beside another hears nothing of its terminal's Ctrl-C, and ends in silence with who has begun it."""

from __future__ import annotations

import contextlib
import os
import signal
import struct
from multiprocessing import Pipe
from pathlib import Path

import pytest

from twin_node.runtime.copies import receive, send
from twin_node.runtime.worker_process import READY, EndedError, WorkerProcess

INTERRUPTED = f"""
import os, signal
os.kill(os.getpid(), signal.SIGINT)  # before anything of this package is imported
from twin_node.runtime.copies import receive, send
from twin_node.runtime.worker_process import run

def main(connection):
    send(connection, {READY!r})
    send(connection, receive(connection))

run(main)
"""


def echo(tmp_path: Path, patience_s: float | None = None) -> contextlib.closing[WorkerProcess]:
    """A process that says what it is told, once."""
    (tmp_path / "interrupted.py").write_text(INTERRUPTED)
    paths = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    return contextlib.closing(WorkerProcess("interrupted", "echo", "try again", {"PYTHONPATH": paths}, patience_s))


def test_an_interrupt_is_left_to_who_began_it(tmp_path: Path) -> None:
    with echo(tmp_path) as begun:
        assert begun.is_loaded(wait=True)
        begun.send("said")
        assert begun.receive() == "said"
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_who_hands_over_what_a_hanging_process_does_not_take_goes_on(tmp_path: Path) -> None:
    with echo(tmp_path, patience_s=0.01) as begun:
        assert begun.is_loaded(wait=True), "to load takes its time"
        os.kill(begun.pid, signal.SIGSTOP)
        with pytest.raises(EndedError, match=r"echo: expected its process \(\d+\) .* hangs, and ended it; .*try again"):
            begun.send(bytes(50_000_000))
        with pytest.raises(ProcessLookupError):
            os.kill(begun.pid, 0)


def test_nobody_hands_over_more_where_a_message_breaks_off() -> None:
    ours, its = Pipe()
    send(ours, {"whole": 1})
    os.write(ours.fileno(), struct.pack("!i", 100) + b"begun")
    ours.close()
    assert receive(its) == {"whole": 1}
    with pytest.raises(EOFError):
        receive(its)
