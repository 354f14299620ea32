"""The bench of the UR driver: figures of the right shape, reasons, and what it refuses. No test asserts a time."""

from __future__ import annotations

import contextlib
import json
import os
import sys

import pytest

from twin_node.arm.ur import DriverState
from twin_node.bench import ur
from twin_node.bench.errors import BenchError
from twin_node.bench.ur_rig import Answer, UrRig
from twin_node.bench.ur_twin import TwinNews
from twin_node.cli import main

pytest.importorskip("rtde_io", reason="ur_rtde is not installed (extra 'ur')")


def test_a_fault_is_injected_answered_and_scored(capsys: pytest.CaptureFixture[str]) -> None:
    scheduled = os.sched_getscheduler(0)
    assert main(["bench", "ur", "--repeats", "1", "--fault", "joints_nan", "--json"]) == 0
    assert os.sched_getscheduler(0) == scheduled, "what runs after it is not to run before everybody else"
    told = json.loads(capsys.readouterr().out)
    score = told["faults"]["joints_nan"]
    assert score["answered"]["repeats"] == 1
    assert (told["unanswered"], told["not_latched"]) == (0, 0)
    assert "not finite" in score["reason"]
    assert told["worst_ms"] == score["answered"]["max_ms"] > 0


def test_without_ur_rtde_no_rig_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def never(mode: object) -> None:
        raise AssertionError("a rig was made")

    monkeypatch.setitem(sys.modules, "rtde_io", None)
    monkeypatch.setattr(ur, "UrRig", never)
    assert main(["bench", "ur", "--repeats", "1"]) == 2
    assert capsys.readouterr().err.strip().endswith("ur_rtde is not installed; install it with: pip install ur-rtde")


class NoNewDriver:
    """A rig whose driver never comes back."""

    is_at_work = True

    def __init__(self, mode: object) -> None:
        pass

    def __enter__(self) -> NoNewDriver:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def prepare(self) -> None:
        pass

    def inject(self, *_: object) -> None:
        pass

    def nobody(self, *_: object) -> None:
        return None

    halted_again = reason = nobody

    def is_latched(self) -> bool:
        return True


def test_a_driver_that_does_not_come_back_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ur, "UrRig", NoNewDriver)
    monkeypatch.setattr(ur, "realtime", lambda priority: contextlib.nullcontext())
    monkeypatch.setattr(ur, "_LATCH_S", 0.0)
    fault = ur.Fault("driver_killed", NoNewDriver.inject, NoNewDriver.inject, NoNewDriver.nobody)
    score = ur._score(fault, 2)
    assert (score.driver_back, score.not_back, score.unanswered) == (None, 2, 2)
    assert ur.UrBench({"driver_killed": score}).as_json()["not_back"] == 2


@pytest.mark.parametrize("killed_ns", [100, 150])
def test_a_driver_that_is_back_before_the_fault_is_answered_counts(killed_ns: int) -> None:
    """It was taken for the one that was killed, and another was waited for in vain: never back, of a quick driver."""
    rig = UrRig.__new__(UrRig)
    at_work, back = (DriverState.READY, "", None, 7), (DriverState.HALTED, "killed", None, 8)
    rig._news = [TwinNews(50, *at_work, 1.0), TwinNews(200, *back, 0.0), TwinNews(250, *back, 0.0)]
    assert rig.halted_again(killed_ns, 0.05) == Answer(200, "killed")


def test_faults_that_are_not_known_are_refused() -> None:
    with pytest.raises(BenchError, match="controller_frozen"):
        ur.run(1, ["earthquake"])


def test_every_fault_has_one_name() -> None:
    assert len(set(ur.FAULT_NAMES)) == len(ur.FAULTS) == 15
