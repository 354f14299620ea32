"""The arm's node: its reaction covers the time until the next decision, and no more than its deadline."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from twin_logs import START, obstacles_at

from twin_node.arm import ArmCollisionChecker, default_path
from twin_node.messages import convert
from twin_node.nodes import arm as arm_node
from twin_node.nodes.arm import GAPS_KEPT, HEARD_NS, ArmNode, ArmParameters
from twin_node.nodes.topics import OBSTACLES, SEPARATION
from twin_node.robot import ur_model
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock

PARAMETERS = ArmParameters("ur5e")
COMMAND_S = PARAMETERS.command_latency_ms * 1e-3


def reactions(gaps_ms: list[int], monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Reaction times (s) that decisions are made with, when obstacles come `gaps_ms` apart."""
    used: list[float] = []
    decide = arm_node.decide

    def watch(checker: Any, path: Any, stamp: int, reaction_s: float, parameters: Any) -> Any:
        used.append(reaction_s)
        return decide(checker, path, stamp, reaction_s, parameters)

    monkeypatch.setattr(arm_node, "decide", watch)
    arm = ur_model("ur5e")
    bus, clock = LocalBus(), SteppedClock(START)
    node = ArmNode(bus, clock, ArmCollisionChecker(arm), default_path(arm), PARAMETERS)
    node.configure()
    node.activate()
    stamp = START
    for gap_ms in gaps_ms:
        stamp += gap_ms * 1_000_000
        clock.advance_to(stamp)
        bus.publish(OBSTACLES, convert.obstacles_to_message(obstacles_at(0, stamp)))
    return used


def test_the_reaction_lasts_until_the_next_decision_is_obeyed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before gaps are known, the deadline counts: after that the arm slows by itself."""
    used = reactions([30] * (GAPS_KEPT + 2), monkeypatch)
    assert used[0] == pytest.approx(PARAMETERS.limiter.deadline_s + COMMAND_S)
    assert used[-1] == pytest.approx(0.03 + COMMAND_S)


def test_a_long_gap_is_remembered_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    used = reactions([30] * 12 + [80] + [30] * (GAPS_KEPT + 1), monkeypatch)
    assert used[11] == pytest.approx(0.03 + COMMAND_S)
    assert used[12 : 12 + GAPS_KEPT] == pytest.approx([0.08 + COMMAND_S] * GAPS_KEPT)
    assert used[12 + GAPS_KEPT] == pytest.approx(0.03 + COMMAND_S)


class Alarm:
    """Remembers for how long it was set."""

    def __init__(self) -> None:
        self.delays: list[float] = []

    def set(self, delay_s: float) -> None:
        self.delays.append(delay_s)


class Timers:
    """One alarm, which the test rings."""

    def __init__(self) -> None:
        self.alarm_ = Alarm()

    def alarm(self, callback: Callable[[], None]) -> Alarm:
        self.ring = callback
        return self.alarm_


def test_silence_is_answered_at_its_deadlines_and_said_again_and_again() -> None:
    arm, timers = ur_model("ur5e"), Timers()
    bus, clock = LocalBus(), SteppedClock(START)
    told: list[tuple[float, float]] = []

    def hear(message: Any) -> None:
        told.append(((clock.now() - arrived) * 1e-9, convert.separation_from_message(message).speed_fraction))

    node = ArmNode(bus, clock, ArmCollisionChecker(arm), default_path(arm), PARAMETERS, timers)
    bus.subscribe(SEPARATION, hear)
    node.configure()
    for i in range(100):
        arrived = START + i * 33_000_000
        clock.advance_to(arrived)
        bus.publish(OBSTACLES, convert.obstacles_to_message(obstacles_at(0, arrived)))
    told.clear()
    for _ in range(5):
        clock.advance_to(clock.now() + round(timers.alarm_.delays[-1] * 1e9))
        timers.ring()
    heard = [at + HEARD_NS * 1e-9 for at, _ in told]
    assert heard == pytest.approx([0.1, 0.15, 0.2, 0.25, 0.3], abs=1e-6)
    fractions = [fraction for _, fraction in told]
    assert fractions[:2] == [PARAMETERS.limiter.slow_fraction] * 2
    assert fractions[2:] == [0.0] * 3
