"""Worker processes end with the one that began them, and leave its interrupt to it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from twin_node.bench.workers import workers

SCRIPT = """
import os, signal, sys, time
from pathlib import Path
from twin_node.bench.workers import workers

def begin():
    Path(sys.argv[1], str(os.getpid())).touch()

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # tests that run in the background have it ignored
    try:
        with workers(2, begin) as pool:
            list(pool.map(time.sleep, [0, 600]))  # one is at work, one waits for some
    except KeyboardInterrupt:
        sys.exit(130)
"""


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and that nobody has asked about does not."""
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


def until(is_so: Callable[[], bool], seconds: float = 60.0) -> bool:
    """Whether a condition comes true in time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if is_so():
            return True
        time.sleep(0.05)
    return False


@pytest.fixture
def at_work(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], list[int]]]:
    """A process with two workers in a group of its own, and who they are."""
    script, found = tmp_path / "script.py", tmp_path / "found"
    script.write_text(SCRIPT)
    found.mkdir()
    command = [sys.executable, str(script), str(found)]
    began = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        assert until(lambda: len(list(found.iterdir())) == 2)
        yield began, [int(path.name) for path in found.iterdir()]
    finally:
        began.kill()
        for path in found.iterdir():
            if alive(int(path.name)):
                os.kill(int(path.name), signal.SIGKILL)


def test_workers_end_with_a_process_that_is_killed(at_work: tuple[subprocess.Popen[str], list[int]]) -> None:
    began, pids = at_work
    began.kill()
    began.wait()
    assert until(lambda: not any(alive(pid) for pid in pids))


def test_an_interrupt_ends_what_has_begun_without_a_word_of_the_workers(
    at_work: tuple[subprocess.Popen[str], list[int]],
) -> None:
    began, pids = at_work
    for pid in pids:
        os.kill(pid, signal.SIGINT)
    assert not until(lambda: not all(alive(pid) for pid in pids), seconds=1.0)
    os.killpg(began.pid, signal.SIGINT)  # as a terminal does
    _, told = began.communicate(timeout=60)
    assert began.returncode == 130
    assert "Traceback" not in told
    assert until(lambda: not any(alive(pid) for pid in pids))


def _doubled(number: int) -> int:
    return 2 * number


def test_results_come_in_order_from_old_and_fresh_processes() -> None:
    for fresh in (False, True):
        with workers(2, fresh=fresh) as pool:
            assert list(pool.map(_doubled, range(4))) == [0, 2, 4, 6]
