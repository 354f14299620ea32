"""Real-time priority: for as long as it is asked for, and for nobody else."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from twin_node.arm.ur.priority import ask_for_realtime, realtime

pytestmark = pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="no scheduler to ask: not a Linux")
OWN = "import os; print(os.sched_getscheduler(0) == os.SCHED_FIFO)"


def test_priority_ends_with_what_it_was_asked_for_and_is_not_inherited() -> None:
    before = os.sched_getscheduler(0)
    with realtime(1) as granted:
        if not granted:
            pytest.skip("real-time priority is not permitted here")
        assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
        assert subprocess.check_output([sys.executable, "-c", OWN], text=True).strip() == "False"
    assert os.sched_getscheduler(0) == before


def test_priority_that_is_refused_leaves_all_as_it_was() -> None:
    before = os.sched_getscheduler(0)
    with realtime(1000) as granted:
        assert not granted
    assert not ask_for_realtime(1000)
    assert os.sched_getscheduler(0) == before
