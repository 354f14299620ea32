"""Orders that an arm's driver does not carry out: which these are, and that somebody hears of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from twin_node.arm.ur import DriverMode, DriverReport, DriverState, UrParameters
from twin_node.cli.ur_driver import _News
from twin_node.errors import TwinError
from twin_node.messages import Message, convert
from twin_node.nodes.topics import DIAGNOSTICS, FOLLOW, kind_of
from twin_node.nodes.ur_driver import TICK_S, UrDriverNode
from twin_node.robot import ur_model
from twin_node.runtime.bus import Bus, LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import JointPath

NOW = 1_700_000_000_000_000_000
SECOND = 1_000_000_000
READY = DriverReport(0, DriverState.READY, "clear", speed_fraction=1.0)


class Driver:
    """Takes what it is ordered, and reports what it is told to."""

    def __init__(self, _: UrParameters, on_report: Callable[[DriverReport], None]) -> None:
        self.on_report = on_report
        self.latest = READY
        self.followed: list[JointPath] = []
        self.came: list[int] = []
        self.left = 0
        self.is_there = True

    def follow(self, path: JointPath, came: int) -> bool:
        self.came.append(came)
        self.followed += [path] * self.is_there
        return self.is_there

    def leave_path(self) -> bool:
        self.left += 1
        return True

    def close(self) -> None:
        pass


class Shift:
    """A node that servoes such an arm, and what is heard of it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, bus: Bus | None = None) -> None:
        monkeypatch.setattr("twin_node.nodes.ur_driver.SupervisedDriver", Driver)
        monkeypatch.setattr(time, "monotonic_ns", lambda: self.passed)
        self.passed = 100 * SECOND
        self.bus, self.heard = bus or LocalBus(), list[Any]()
        self.bus.subscribe(DIAGNOSTICS, self.heard.append)
        self.node = UrDriverNode(self.bus, SteppedClock(NOW), UrParameters(mode=DriverMode.SERVO))
        self.node.configure()
        self.node.activate()
        assert isinstance(self.node._driver, Driver)
        self.driver = self.node._driver

    def tick(self) -> str | None:
        """What is told to have been refused."""
        self.passed += round(TICK_S * SECOND)
        self.node.tick()
        (found,) = convert.diagnostics_from_message(self.heard[-1])
        return next((reading.value for reading in found.readings if reading.key == "refused"), None)


@pytest.fixture
def shift(monkeypatch: pytest.MonkeyPatch) -> Shift:
    shift = Shift(monkeypatch)
    shift.tick()
    return shift


def path(stamp: int) -> Message:
    """Of two seconds, to follow from a time on, ns."""
    names = ur_model("ur5e").joint_names
    message = convert.joint_path_to_message(JointPath(names, NOW + np.array([0, 2 * SECOND]), np.zeros((2, 6))))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, SECOND)
    return message


@pytest.mark.parametrize("stamp", [0, NOW, NOW - 1_900_000_000, NOW + 150_000_000])
def test_a_path_for_now_is_followed(shift: Shift, stamp: int) -> None:
    shift.bus.publish(FOLLOW, path(stamp))
    assert len(shift.driver.followed) == 1
    assert shift.tick() is None


@pytest.mark.parametrize(
    ("stamp", "found"),
    [
        (NOW - 3600 * SECOND, "by its stamp was over 3598.00 s ago"),
        (NOW - 2_100_000_000, "by its stamp was over 0.10 s ago"),
        (NOW + 500_000_000, "by its stamp is to begin in 0.50 s"),
    ],
)
def test_a_path_of_another_time_is_refused_and_told(shift: Shift, stamp: int, found: str) -> None:
    """One of a recording was followed wherever the arm stood at its beginning."""
    with pytest.raises(TwinError, match="stamp it 0"):
        shift.bus.publish(FOLLOW, path(stamp))
    assert not shift.driver.followed
    assert found in str(shift.tick())


def test_the_driver_is_told_when_a_path_came(monkeypatch: pytest.MonkeyPatch) -> None:
    """One stamped 0 that had waited for a node held up by its console was followed as if it had just come."""
    executor = Executor()
    bus = WireBus(LocalWire(), executor, "ur_driver", kind_of)
    shift = Shift(monkeypatch, bus)
    came = shift.passed
    bus.publish(FOLLOW, path(0))
    shift.passed += SECOND
    while not shift.driver.came:
        assert executor.step(1.0)
    assert shift.driver.came == [came]


def test_an_old_order_to_stay_is_obeyed(shift: Shift) -> None:
    message = path(NOW - 3600 * SECOND)
    message.points = []
    shift.bus.publish(FOLLOW, message)
    assert shift.driver.left == 1


def test_a_path_that_is_none_and_one_without_an_arm_are_told(shift: Shift) -> None:
    """The command said nothing, and the arm stood."""
    short = path(0)
    short.points[1].positions = short.points[1].positions[:5]
    shift.driver.is_there = False
    for message in (short, path(0)):
        with pytest.raises(TwinError):
            shift.bus.publish(FOLLOW, message)
    assert "5 positions for 6 joints" in str(shift.tick())
    assert "no connection to the controller" in str(shift.tick())


def test_a_refusal_is_told_though_a_newer_report_has_come(shift: Shift) -> None:
    """Between two ticks the driver reports once or twice: the report with the refusal was at times never looked at."""
    shift.driver.on_report(replace(READY, refusal="trajectory: too fast"))
    shift.driver.on_report(READY)
    assert shift.tick() == "trajectory: too fast"
    shift.passed += SECOND
    assert shift.tick() is None


def test_what_is_refused_again_and_again_is_told_once(shift: Shift) -> None:
    """Decisions by a clock that is ahead: 25 lines per second, and as many diagnostics."""
    news, lines, before = _News(), list[str | None](), len(shift.heard)
    for tick in range(200):
        if (tick + 1) % 3:
            shift.driver.on_report(replace(READY, refusal=f"decision: {10 + tick / 100:.3g} s in the future"))
        shift.tick()
        lines.append(news.of(shift.node.report))
    assert [line for line in lines if line] == ["ready: clear (refused: decision: 10 s in the future)"]
    assert len(shift.heard) - before <= 5
