"""The arm's node: its reaction covers the time until the next decision, and no more than it goes on without one."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from arm_cell import MODEL, READY, TURNING, Cell, Timers
from twin_logs import START, obstacles_at

from twin_node.arm import ArmCollisionChecker, default_path
from twin_node.errors import TwinError
from twin_node.messages import convert
from twin_node.nodes import arm as arm_node
from twin_node.nodes.arm import GAPS_KEPT, HEARD_NS, ArmNode, Driving
from twin_node.nodes.arm_parameters import ArmParameters
from twin_node.nodes.topics import JOINT_STATES, OBSTACLES, SEPARATION
from twin_node.robot import forward_kinematics, ur_model
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.scene import JointSample, ObstacleKind, Obstacles

PARAMETERS = ArmParameters("ur5e")
COMMAND_S = PARAMETERS.command_latency_ms * 1e-3


def reactions(gaps_ms: list[int], monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Reaction times (s) that decisions are made with, when obstacles come `gaps_ms` apart."""
    used: list[float] = []
    decide = arm_node.decide

    def watch(checker: Any, path: Any, stamp: int, reaction_s: float, *given: Any) -> Any:
        used.append(reaction_s)
        return decide(checker, path, stamp, reaction_s, *given)

    monkeypatch.setattr(arm_node, "decide", watch)
    arm = ur_model("ur5e")
    bus, clock = LocalBus(), SteppedClock(START)
    node = ArmNode(bus, clock, ArmCollisionChecker(arm), lambda: default_path(arm), PARAMETERS)
    node.configure()
    node.activate()
    stamp = START
    for gap_ms in gaps_ms:
        stamp += gap_ms * 1_000_000
        clock.advance_to(stamp)
        bus.publish(OBSTACLES, convert.obstacles_to_message(obstacles_at(0, stamp)))
    return used


def test_the_reaction_lasts_until_the_next_decision_is_obeyed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before gaps are known, two deadlines count: after that the arm stands by itself."""
    used = reactions([30] * (GAPS_KEPT + 2), monkeypatch)
    assert used[0] == pytest.approx(2 * PARAMETERS.limiter.deadline_s + COMMAND_S)
    assert used[-1] == pytest.approx(0.03 + COMMAND_S)


def test_a_long_gap_is_remembered_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    used = reactions([30] * 12 + [80] + [30] * (GAPS_KEPT + 1), monkeypatch)
    assert used[11] == pytest.approx(0.03 + COMMAND_S)
    assert used[12 : 12 + GAPS_KEPT] == pytest.approx([0.08 + COMMAND_S] * GAPS_KEPT)
    assert used[12 + GAPS_KEPT] == pytest.approx(0.03 + COMMAND_S)


def test_a_slow_arm_that_goes_on_between_two_slow_forecasts_reacts_as_late(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 7 Hz it went on at a fifth of its speed after the one deadline that counted, and met who came meanwhile."""
    assert reactions([140] * 3 + [900], monkeypatch)[-2:] == pytest.approx([0.2 + COMMAND_S] * 2)
    assert reactions([140] * 11, monkeypatch)[-1] == pytest.approx(0.14 + COMMAND_S)


def test_silence_is_answered_at_its_deadlines_and_said_again_and_again() -> None:
    arm, timers = ur_model("ur5e"), Timers()
    bus, clock = LocalBus(), SteppedClock(START)
    told: list[tuple[float, float]] = []

    def hear(message: Any) -> None:
        told.append(((clock.now() - arrived) * 1e-9, convert.separation_from_message(message).speed_fraction))

    node = ArmNode(bus, clock, ArmCollisionChecker(arm), lambda: default_path(arm), PARAMETERS, timers)
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


def test_an_arm_is_told_to_stand_before_any_forecast_has_come() -> None:
    timers = Timers()
    cell = Cell(timers)
    assert timers.alarm_.delays
    timers.ring()
    assert (cell.told[-1].speed_fraction, cell.told[-1].reason) == (0.0, "stopped: no forecast yet")


def test_a_decision_tells_that_its_arm_is_made_up_until_somebody_tells_of_one() -> None:
    cell, far = Cell(), np.full(3, 5.0)
    assert "made-up arm" in cell.somebody(at=far).reason
    cell.joints()
    assert "made-up" not in cell.somebody(at=far).reason


@pytest.mark.parametrize(("given", "intrusion_m"), [({}, 0.2), ({"separation": {"intrusion_m": 0.5}}, 0.5)])
def test_the_law_is_that_of_the_arms_file(given: dict[str, object], intrusion_m: float) -> None:
    cell = Cell(**given)
    cell.joints()
    assert cell.somebody().term_intrusion == intrusion_m


@pytest.mark.parametrize("told", ["some joints", "NaN joints", "NaN path", "to stay"])
def test_an_arm_of_which_nothing_is_told_that_can_be_believed_stands_and_is_none_made_up(told: str) -> None:
    """It was let go at full speed where nobody stands in the way of a made-up cycle."""
    cell = Cell()
    whole = JointSample(START, MODEL.joint_names, READY, TURNING)
    some = replace(whole, names=whole.names[:5], positions=READY[:5], velocities=TURNING[:5])
    if told == "to stay":
        cell.stay()
        reason = "the arm is to stay where it is, and nobody has told where"
    else:
        with pytest.raises(TwinError) as refusal:
            if told == "NaN path":
                cell.path(begins_ms=0, lasts_ms=200, velocity=TURNING * np.nan)
            elif told == "NaN joints":
                cell.joints(READY * np.nan)
            else:
                cell.bus.publish(JOINT_STATES, convert.joint_sample_to_message(some))
        reason = str(refusal.value)
    decision = cell.somebody(at=np.full(3, 5.0))
    assert (decision.speed_fraction, decision.reason) == (0.0, f"stopped: {reason}")
    assert (convert.Level.ERROR, reason) in [(d.level, d.message) for d in cell.node.diagnoses()]
    cell.joints()
    assert cell.somebody(at=np.full(3, 5.0)).reason == "clear; speeding up"


def test_an_arm_whose_driver_a_graph_tells_of_a_moment_later_stands() -> None:
    """With the first obstacles the graph was first asked who drives: it knew of nobody yet, and the arm was let go."""
    asked: list[Driving] = []

    def driving() -> Driving:
        asked.append(Driving.BY_SLIDER if asked else Driving.NOBODY)
        return asked[-1]

    decision = Cell(driving=driving).somebody(at=np.full(3, 5.0))
    assert decision.reason == "stopped: an arm is driven, and nobody publishes its /joint_states or /arm/trajectory"


def test_an_arm_with_a_driver_of_ones_own_stands_until_somebody_tells_where_it_is() -> None:
    cell = Cell(driven=True)
    decision = cell.somebody(at=np.full(3, 5.0))
    assert (decision.speed_fraction, decision.reason) == (
        0.0,
        "stopped: an arm is driven, and nobody publishes its /joint_states or /arm/trajectory",
    )
    cell.joints()
    assert cell.somebody(at=np.full(3, 5.0)).reason == "clear; speeding up"


def test_an_arm_that_works_where_nobody_looks_is_told_of_for_a_while() -> None:
    """Nothing is seen there, and it went there at full speed without a word."""

    def told() -> convert.Diagnosis:
        return next(diagnosis for diagnosis in cell.node.diagnoses() if diagnosis.name == "arm: reach")

    cell = Cell()
    inside = READY + 0.3 * np.eye(6)[1]
    cell.joints(inside)
    cell.somebody()
    assert told().level is convert.Level.OK
    cell.wait(500)
    cell.joints(inside + 1.5 * TURNING)
    cell.somebody()
    cell.wait(1000)
    cell.joints(inside)
    cell.somebody()
    assert told().level is convert.Level.WARN
    assert "outside the workspace, where nothing is looked for" in told().message
    cell.wait(10_000)
    assert told().level is convert.Level.OK


def test_a_path_that_has_not_begun_or_is_over_does_not_say_where_the_arm_is() -> None:
    cell = Cell()
    cell.joints()
    cell.path(begins_ms=300, lasts_ms=200)
    assert cell.somebody().reason == "slow for MOVING"  # the path alone would have it stand
    cell.path(begins_ms=-201, lasts_ms=200, velocity=np.zeros(6))
    assert cell.somebody().reason == "slow for MOVING"
    cell.path(begins_ms=-100, lasts_ms=200, velocity=np.zeros(6))
    assert cell.somebody().reason == "clear; speeding up"


@pytest.mark.parametrize(("begun_ms", "begins_ms"), [(199, 0), (5, 194), (5, 350)])
def test_an_arm_does_not_stand_where_its_path_is_told_no_further(begun_ms: int, begins_ms: int) -> None:
    """A driver tells of 200 ms; the joints of an arm that is slowed say less than what its program means to do."""
    cell = Cell()
    cell.joints(READY + begun_ms * 1e-3 * TURNING, qd=0.02 * TURNING)
    cell.path(begins_ms=-begun_ms, lasts_ms=200)
    assert "for MOVING" in cell.somebody(begins_ms=begins_ms).reason


def test_a_log_whose_recording_times_lie_before_its_stamps_is_judged_by_its_stamps() -> None:
    cell = Cell()
    cell.joints(ago_ms=-900)
    assert cell.somebody(ahead_ms=900).reason == "slow for MOVING"


def test_who_has_heard_of_an_arm_never_judges_a_made_up_one() -> None:
    cell = Cell()
    assert [d.level for d in cell.node.diagnoses()[:1]] == [convert.Level.WARN]
    cell.path(begins_ms=0, lasts_ms=200)
    assert [d.level for d in cell.node.diagnoses()[:1]] == [convert.Level.OK]
    cell.wait(500)
    assert cell.somebody().reason == "stopped: the arm's trajectory is over, and no joints come"
    cell.path(begins_ms=500, lasts_ms=200)
    assert cell.somebody().reason == "stopped: the arm's trajectory has not begun, and no joints come"


def test_an_arm_that_is_told_to_stay_goes_along_its_path_no_longer() -> None:
    """As ROS's trajectory controllers are told: by a trajectory without points."""
    cell = Cell()
    cell.joints()
    cell.path(begins_ms=-100, lasts_ms=2000, velocity=np.zeros(6))
    assert cell.somebody().reason == "clear; speeding up"  # its path has it stand
    cell.stay()
    assert cell.somebody().reason == "slow for MOVING"  # its joints still turn
    cell.path(begins_ms=-100, lasts_ms=2000, velocity=np.zeros(6))
    assert cell.somebody().reason == "clear; speeding up"
    alone = Cell()
    alone.path(begins_ms=-100, lasts_ms=2000)
    alone.stay()
    assert alone.somebody().reason == "stopped: the arm's trajectory is over, and no joints come"


def test_an_arm_that_stands_for_want_of_forecasts_is_told_of() -> None:
    """A twin that hangs cannot, and of what has ended nobody speaks: all that was left in the diagnostics was OK."""

    def told() -> tuple[convert.Level, str]:
        return next((d.level, d.message) for d in cell.node.diagnoses() if d.name == "arm: forecasts")

    cell, stands = Cell(), ": the arm stands; look at the twin's status"
    assert told() == (convert.Level.ERROR, f"no forecast yet{stands}")
    cell.joints()
    cell.somebody()
    assert told() == (convert.Level.OK, "in time")
    cell.somebody(ahead_ms=120)
    assert told()[0] is convert.Level.WARN
    assert told()[1].startswith("their evidence lies 120 ms in the future")
    cell.somebody()
    cell.wait(201)
    assert told() == (convert.Level.ERROR, f"no forecast for 201 ms{stands}")
    cell.somebody(ahead_ms=-450)
    assert told()[1].startswith("no forecast that is young enough: those that come are of 450 ms before")
    assert told()[1].endswith(f"clocks that differ){stands}")
    with pytest.raises(TwinError, match="map"):
        cell.somebody(frame="map")
    assert told()[1].startswith("refused: obstacles: expected them in base_link")


def test_obstacles_of_before_1970_are_refused_and_the_arm_says_so() -> None:
    """Their stamp was taken, and could not be passed on when no more came: the arm's process ended of one message."""
    timers = Timers()
    cell = Cell(timers)
    cell.joints()
    message = convert.obstacles_to_message(Obstacles.none(START))
    message.header.stamp.sec = -1
    with pytest.raises(TwinError, match="obstacles' stamp -"):
        cell.bus.publish(OBSTACLES, message)
    cell.wait(201)
    timers.ring()
    assert cell.told[-1].speed_fraction == 0.0
    assert "obstacles' stamp" in cell.told[-1].reason


def test_a_path_that_the_arm_is_not_on_is_told_of() -> None:
    """A planner publishes it once and knows nothing of an arm that the twin holds back: that stood 1 rad behind it."""
    cell = Cell()
    cell.path(begins_ms=-1000, lasts_ms=4000)
    cell.joints(qd=np.zeros(6))
    assert cell.somebody().reason == "clear; speeding up"
    diagnosis = cell.node.diagnoses()[0]
    assert diagnosis.level is convert.Level.WARN
    assert diagnosis.message.startswith("the arm is 0.90 rad from where /arm/trajectory has it")
    cell.path(begins_ms=0, lasts_ms=4000)
    cell.somebody()
    assert [d.level for d in cell.node.diagnoses()[:1]] == [convert.Level.OK]


def test_an_arm_that_still_brakes_is_known_to() -> None:
    """Its joints say so; a log's arm, which heard nobody, does not brake."""
    told, beside = {}, forward_kinematics(MODEL, READY)[-1, :3, 3] + np.array([0.0, 0.2, 0.0])
    for timers in (Timers(), None):
        for speed in (0.0, 1.0):
            cell = Cell(timers, servoed=True)
            for _ in range(40):
                cell.wait(30)
                cell.path(0, 200)
                cell.joints(qd=speed * TURNING)
                told[timers is None, speed] = cell.somebody(kind=ObstacleKind.STATIC, at=beside).speed_fraction
    assert told[False, 1.0] < told[False, 0.0] - 0.1
    assert told[True, 1.0] == told[True, 0.0] == told[False, 0.0] > 0


def test_a_path_without_a_stamp_begins_when_it_comes() -> None:
    cell = Cell()
    cell.joints()
    cell.path(begins_ms=0, lasts_ms=2000, velocity=np.zeros(6), is_stamped=False)
    assert cell.somebody().reason == "clear; speeding up"  # its path has it stand, its joints do not


def test_a_path_that_is_not_finite_is_refused_when_it_comes() -> None:
    cell = Cell()
    cell.joints()
    with pytest.raises(TwinError, match="finite"):
        cell.path(begins_ms=0, lasts_ms=200, velocity=TURNING * np.nan)
    assert cell.somebody().reason == "slow for MOVING"


def test_who_sends_a_path_that_is_refused_goes_no_longer_along_the_one_before() -> None:
    cell, alone = Cell(), Cell()
    cell.joints()
    for one in (cell, alone):
        one.path(begins_ms=-100, lasts_ms=2000, velocity=np.zeros(6))
        assert one.somebody().reason == "clear; speeding up"  # its path has it stand
        with pytest.raises(TwinError, match="finite"):
            one.path(begins_ms=0, lasts_ms=2000, velocity=TURNING * np.nan)
    assert cell.somebody().reason == "slow for MOVING"  # its joints turn
    assert alone.somebody().reason == "stopped: the arm's trajectory is over, and no joints come"


def test_obstacles_that_are_refused_are_named_where_the_arm_is_told_to_stand() -> None:
    timers = Timers()
    cell = Cell(timers)
    cell.joints()
    cell.somebody()
    cell.wait(33)
    with pytest.raises(TwinError, match="raise max_obstacles"):
        cell.somebody(count=9)
    cell.wait(300)
    timers.ring()
    assert cell.told[-1].speed_fraction == 0.0
    assert "no forecast for 338 ms; the last was refused: obstacles: expected at most 8" in cell.told[-1].reason
    cell.joints()
    assert cell.somebody().reason == "slow for MOVING"


def test_a_refusal_is_not_told_of_a_silence_after_later_obstacles() -> None:
    timers = Timers()
    cell = Cell(timers)
    cell.joints()
    with pytest.raises(TwinError, match="raise max_obstacles"):
        cell.somebody(count=9)
    cell.wait(33)
    cell.somebody()
    cell.wait(300)
    timers.ring()
    assert cell.told[-1].reason == "stopped: no forecast for 305 ms"


@pytest.mark.parametrize("value", [-1.0, math.nan, 1e30])
def test_a_command_arrives_neither_before_it_is_sent_nor_never(value: float) -> None:
    """The latter ended in a trace of NumPy's."""
    with pytest.raises(TwinError, match=f"command_latency_ms: expected 0 to 10000, found {re.escape(f'{value:g}')}"):
        ArmParameters(command_latency_ms=value)
    with pytest.raises(TwinError, match=f"slide_s: expected 0 to 10, found {re.escape(f'{value:g}')}"):
        ArmParameters(slide_s=value)


@pytest.mark.parametrize("frame", ["base", "world", ""])
def test_obstacles_in_another_frame_are_refused(frame: str) -> None:
    """In `base`, half a turn about z away, whoever stands before the arm would be held for behind it."""
    cell = Cell()
    cell.joints()
    with pytest.raises(TwinError, match=f"expected them in base_link, found {frame!r}"):
        cell.somebody(frame=frame)
    assert cell.somebody(frame="/base_link").reason == "slow for MOVING"
