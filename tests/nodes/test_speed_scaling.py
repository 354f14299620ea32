"""What a joint_trajectory_controller is told of its speed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from twin_node.errors import TwinError
from twin_node.messages import convert
from twin_node.nodes.arm import Driving
from twin_node.nodes.live import speed_scaling
from twin_node.nodes.live.beside_twin import _driving, _who_obeys
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.live.speed_scaling import KeptShare, SpeedScalingParameters, make_speed_scaling
from twin_node.nodes.topics import JOINT_STATES, SEPARATION, kind_of, kind_of_own
from twin_node.robot import ur_model
from twin_node.runtime.executor import Executor
from twin_node.runtime.rmw_zenoh import Endpoint, EntityKind, NodeIdentity
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import JointSample, Separation

START = 1_700_000_000_000_000_000
TOPIC = "/joint_trajectory_controller/speed_scaling_input"
PERIOD_S = 0.02
JOINTS = ur_model("ur10e").joint_names
"""Of the arm that is judged where nothing else is said."""


def subscriber(node: str, topic: str) -> Endpoint:
    kind = kind_of_own(topic)
    return Endpoint(EntityKind.SUBSCRIBER, NodeIdentity("a1", 0, node), 1, topic, kind.msgtype or "", "", kind.qos)


class Controller:
    """A controller that listens to the node on a wire of the test's own, by a clock that the test turns."""

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        listens: bool = True,
        joints_rad_s: float | None = 1.0,
        kept: Path | None = None,
    ) -> None:
        """`joints_rad_s`: how fast the arm's fastest joint is when the node begins; None: nobody says."""
        self.passed = 0.0
        self.wire, self._executor = LocalWire(), Executor()
        self.told: list[float] = []
        if listens:
            self.wire.subscribe(
                "controller", TOPIC, kind_of_own(TOPIC), lambda message: self.told.append(message.factor)
            )
        turning = SimpleNamespace(monotonic=lambda: self.passed, sleep=self.wait)
        monkeypatch.setattr(speed_scaling, "time", turning)
        ticks: list[Callable[[], None]] = []
        timers = SimpleNamespace(every=lambda period, tick: ticks.append(tick))
        bus = WireBus(self.wire, self._executor, "speed_scaling", kind_of)
        clock = SimpleNamespace(now=lambda: START + round(self.passed * 1e9))
        sections = {"arm": {"slide_s": 0.2}}
        there = (subscriber("controller", TOPIC),) if listens else ()
        given: tuple[Any, ...] = (bus, clock, timers, sections, "test", lambda: None, lambda: there)
        self.said: list[str] = []
        setup = Setup("speed_scaling", *given, self.said.append, kept=kept)
        self.node = make_speed_scaling(setup)
        self.node.configure()
        self.node.activate()
        (self._tick,) = ticks
        self._send = self.wire.publisher("arm", SEPARATION, kind_of_own(SEPARATION))
        self._say_joints = self.wire.publisher("driver", JOINT_STATES, kind_of_own(JOINT_STATES))
        if joints_rad_s is not None:
            self.say_joints(dict.fromkeys(JOINTS, 0.0) | {JOINTS[1]: -joints_rad_s})

    def say_joints(self, velocities: Mapping[str, float]) -> None:
        """Somebody tells of joints, rad/s; of some that they do not know how fast they are (NaN)."""
        told = JointSample(START, tuple(velocities), np.zeros(len(velocities)), np.array([*velocities.values()]))
        self._say_joints(convert.joint_sample_to_message(told))
        self._hear()

    def _hear(self) -> None:
        while self._executor.step(0.0):
            pass

    def move(self, seconds: float, joints_rad_s: float, decided: float) -> None:
        """A share is decided, while joints say that they are so fast."""
        for _ in range(round(seconds / 0.1)):
            self.run(0.1, decided)
            self.say_joints(dict.fromkeys(JOINTS, 0.0) | {JOINTS[1]: -joints_rad_s})
            self.say_joints({"left_finger": 0.3})

    def wait(self, seconds: float) -> None:
        self.passed += seconds

    def run(self, seconds: float, decided: float | None = None, ahead_s: float = 0.0) -> list[float]:
        """What the controller is told in that time, in which a share is decided thirty times a second, or nothing.

        `ahead_s`: by how much the clock of who decides is ahead.
        """
        before, next_s = len(self.told), self.passed
        until = self.passed + seconds
        while self.passed < until - 1e-9:
            self.wait(PERIOD_S)
            if decided is not None and self.passed >= next_s:
                next_s += 1 / 30
                now = START + round((self.passed + ahead_s) * 1e9)
                self._send(convert.separation_to_message(Separation.without_pair(now, now, decided, "test")))
                self._hear()
            self._tick()
        return self.told[before:]


def test_a_controller_is_told_what_is_decided(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = Controller(monkeypatch, joints_rad_s=None)
    assert controller.node.diagnoses()[0].readings == (), "nobody knows yet"
    controller.run(2.0, 1.0)
    assert controller.told[-1] == 1.0
    controller.run(1.0, 0.4)
    assert controller.told[-1] == 0.4
    (one,) = controller.node.diagnoses()
    assert one.readings == (convert.Reading("share", "0.40"),)


def test_it_slows_as_the_arm_can_brake_and_no_faster(monkeypatch: pytest.MonkeyPatch) -> None:
    """A joint_trajectory_controller takes a share at once: at 0 it would stop within a period."""
    controller = Controller(monkeypatch)
    controller.run(2.0, 1.0)
    told = [1.0, *controller.run(0.4, 0.0)]
    falls = [before - after for before, after in pairwise(told)]
    assert max(falls) == pytest.approx(PERIOD_S / 0.2)
    assert len([fall for fall in falls if fall > 0]) == pytest.approx(0.2 / PERIOD_S, abs=1), "and no slower"
    assert told[-1] == 0.0


def test_a_node_that_was_held_up_slows_the_arm_no_faster(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of its speed was followed by none at once: what it had been told by then was long over."""
    controller = Controller(monkeypatch)
    controller.run(2.0, 1.0)
    controller.wait(5.0)
    told = [1.0, *controller.run(0.4)]
    assert max(before - after for before, after in pairwise(told)) == pytest.approx(3 * PERIOD_S / 0.2)
    assert told[-1] == 0.0


@pytest.mark.parametrize("joints_rad_s", [1.0, 0.015], ids=["fast", "creeping"])
def test_an_arm_that_moves_already_is_slowed_from_all_of_its_speed(
    monkeypatch: pytest.MonkeyPatch, joints_rad_s: float
) -> None:
    """Which is what a controller has that nobody has told anything."""
    told = Controller(monkeypatch, joints_rad_s=joints_rad_s).run(0.5)
    assert told[0] == pytest.approx(1 - PERIOD_S / 0.2)
    assert told == sorted(told, reverse=True)
    assert told[-1] == 0.0


def test_an_arm_that_stands_is_not_set_going_by_a_node_that_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its controller may have been left at none by the one before."""
    controller = Controller(monkeypatch, joints_rad_s=0.001)
    told = controller.run(0.3)
    assert set(told) == {0.0}
    assert controller.run(0.1, 1.0) == sorted(controller.told[-5:])
    assert 0 < controller.told[-1] < 0.3, "it speeds up as an arm does"


def test_an_arm_of_which_nobody_knows_whether_it_moves_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = Controller(monkeypatch, joints_rad_s=None)
    assert controller.run(0.4, 1.0) == []
    told = controller.run(0.3, 1.0)
    assert told == sorted(told)
    assert told[0] < 0.1, "and from there its speed rises"


def test_a_gripper_that_stands_says_nothing_of_the_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    """The controller of an arm at full speed was told 0 at once, which it obeys within a period."""
    controller = Controller(monkeypatch, joints_rad_s=None)
    controller.say_joints({"gripper": 0.0})
    assert controller.run(0.1) == []
    controller.say_joints(dict.fromkeys(JOINTS, 1.0))
    controller.say_joints({"gripper": 0.0})
    assert controller.run(PERIOD_S)[0] == pytest.approx(1 - PERIOD_S / 0.2)


def test_a_joint_whose_speed_nobody_measures_does_not_hide_that_the_others_move(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    controller = Controller(monkeypatch, joints_rad_s=None)
    controller.say_joints(dict.fromkeys(JOINTS, np.nan))
    assert controller.run(0.1) == []
    controller.say_joints(dict.fromkeys(JOINTS, 1.0) | {JOINTS[0]: np.nan})
    assert controller.run(PERIOD_S)[0] == pytest.approx(1 - PERIOD_S / 0.2)


def test_joints_that_are_told_of_in_several_messages_are_one_arms(monkeypatch: pytest.MonkeyPatch) -> None:
    """The controller of an arm whose base turned was told 0 at once, for its wrists stood."""
    controller = Controller(monkeypatch, joints_rad_s=None)
    controller.say_joints(dict.fromkeys(JOINTS[:3], 1.0))
    controller.say_joints(dict.fromkeys(JOINTS[3:], 0.0))
    assert controller.run(PERIOD_S)[0] == pytest.approx(1 - PERIOD_S / 0.2)


def test_joints_that_stand_are_not_all_of_an_arm_until_the_others_are_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its wrists were told of first: 0 went out at once, before the base's message came."""
    controller = Controller(monkeypatch, joints_rad_s=None)
    controller.say_joints(dict.fromkeys(JOINTS[3:], 0.0))
    assert controller.run(PERIOD_S) == []
    controller.say_joints(dict.fromkeys(JOINTS[:3], 1.0))
    assert controller.run(PERIOD_S)[0] == pytest.approx(1 - PERIOD_S / 0.2)


def test_a_belt_that_runs_beside_an_arm_says_nothing_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """An arm that stood was set going by what its controller was told for it, which was taken to be at full speed."""
    controller = Controller(monkeypatch, joints_rad_s=0.0)
    controller.say_joints({"belt": 5.0})
    assert set(controller.run(0.3)) == {0.0}


def test_a_node_that_takes_the_place_of_one_that_was_killed_goes_on_from_there(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    killed = Controller(monkeypatch, kept=tmp_path)
    killed.run(2.0, 0.5)
    after = Controller(monkeypatch, kept=tmp_path)
    assert after.run(0.1)[0] == pytest.approx(0.5 - PERIOD_S / 0.2)


def test_a_file_that_is_cut_short_tells_nothing(tmp_path: Path) -> None:
    kept = KeptShare(tmp_path / "share")
    assert kept.read() is None
    kept.write(0.25)
    assert KeptShare(tmp_path / "share").read() == 0.25
    (tmp_path / "share").write_bytes(b"123")
    assert kept.read() is None
    KeptShare(tmp_path / "nowhere" / "share").write(0.5)


def test_without_decisions_the_arm_is_slow_and_then_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = Controller(monkeypatch)
    controller.run(2.0, 1.0)
    controller.run(0.02)
    assert controller.told[-1] == 1.0
    controller.run(0.54)
    assert controller.told[-1] == 0.0
    (one,) = controller.node.diagnoses()
    assert one.level is convert.Level.OK
    assert one.message.startswith("stopped: no forecast for 5")


def test_decisions_by_evidence_of_the_future_stop_the_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody knows how old it is: the UR driver halts, and here the arm went on at full speed by what it said."""
    controller = Controller(monkeypatch)
    controller.run(2.0, 1.0, ahead_s=0.19)
    assert controller.told[-1] == 1.0, "clocks may differ by as much as evidence may be old"
    controller.run(0.5, 1.0, ahead_s=0.3)
    assert controller.told[-1] == 0.0
    (one,) = controller.node.diagnoses()
    assert one.message.startswith("stopped: the evidence lies 300 ms in the future, so nobody knows how old it is")
    controller.run(1.0, 1.0)
    assert controller.told[-1] == 1.0


def test_a_share_that_stays_is_told_again_for_a_controller_that_is_new(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = Controller(monkeypatch)
    controller.run(2.0, 1.0)
    assert controller.run(2.0, 1.0) == [1.0] * 4


def test_a_stop_that_is_lost_is_told_again_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a link is full, messages are dropped: the controller went on for half a second by the last that came."""
    controller = Controller(monkeypatch)
    controller.run(2.0, 1.0)
    controller.run(0.3, 0.0)
    assert controller.told[-1] == 0.0
    assert controller.run(0.1, 0.0) == [0.0] * 5
    assert controller.run(1.0, 0.4)[-10:] == [0.4] * 10


def test_the_arm_stands_when_the_node_has_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = Controller(monkeypatch)
    controller.run(2.0, 1.0)
    before, begun = len(controller.told), controller.passed
    controller.node.deactivate()
    assert controller.told[-1] == 0.0
    assert controller.passed - begun == pytest.approx(0.2, abs=2 * PERIOD_S)
    assert controller.told[before:] == sorted(controller.told[before:], reverse=True)
    assert controller.run(1.0, 1.0) == [], "it has ended"


def test_an_arm_that_moves_though_it_is_told_to_stand_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    """One whose controller commands velocities goes on at them, whatever share it is told."""
    controller = Controller(monkeypatch)
    controller.move(1.0, 0.8, 1.0)
    controller.move(1.2, 0.4, 0.0)
    assert controller.said == [], "it may still be braking"
    controller.move(3.0, 0.4, 0.0)
    (line,) = controller.said
    assert line.startswith("the arm moves, by 0.40 rad/s, though its controller has been told to stand")
    (one,) = controller.node.diagnoses()
    assert (one.level, one.message) == (convert.Level.ERROR, line)
    controller.move(1.0, 0.01, 0.0)
    assert controller.node.diagnoses()[0].level is convert.Level.OK
    controller.move(1.0, 0.4, 1.0)
    assert controller.node.diagnoses()[0].level is convert.Level.OK, "it may move"
    assert controller.said == [line]


def test_a_gripper_that_moves_beside_an_arm_that_stands_is_none_that_disobeys(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = Controller(monkeypatch)
    controller.move(5.0, 0.01, 0.0)
    assert controller.said == []


def test_a_controller_that_is_not_there_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = Controller(monkeypatch, listens=False)
    controller.run(0.1, 1.0)
    (one,) = controller.node.diagnoses()
    assert one.level is convert.Level.ERROR
    assert one.message.startswith(f"nobody hears {TOPIC}: no controller of that name is active")


@pytest.mark.parametrize(
    ("name", "topic"),
    [
        ("scaled_joint_trajectory_controller", "/scaled_joint_trajectory_controller/speed_scaling_input"),
        ("/left/arm_controller/", "/left/arm_controller/speed_scaling_input"),
    ],
)
def test_a_controller_is_named_with_its_namespace(name: str, topic: str) -> None:
    assert SpeedScalingParameters(controller=name).topic == topic


@pytest.mark.parametrize(
    ("parameters", "told"),
    [
        ({"controller": ""}, "controller: expected a name such as joint_trajectory_controller, found ''"),
        ({"controller": "my arm"}, "controller: expected a name such as joint_trajectory_controller, found 'my arm'"),
        ({"rate_hz": 0.0}, "rate_hz: expected 1 to 1000, found 0"),
    ],
)
def test_wrong_parameters_are_named(parameters: dict[str, Any], told: str) -> None:
    with pytest.raises(TwinError, match=told):
        SpeedScalingParameters(**parameters)


def test_an_arm_that_is_slowed_so_is_one_that_obeys() -> None:
    """Without its joints it stands, in place of one that is made up."""
    kind = kind_of_own(SEPARATION)
    hears = Endpoint(
        *(
            EntityKind.SUBSCRIBER,
            NodeIdentity("a1", 0, "speed_scaling"),
            1,
            SEPARATION,
            kind.msgtype or "",
            "",
            kind.qos,
        )
    )
    assert _driving([hears]) is Driving.BY_SLIDER
    assert _driving([]) is Driving.NOBODY
    ours, theirs = (SimpleNamespace(endpoints=lambda: [hears], namespace=namespace) for namespace in ("/", "/a"))
    assert _who_obeys(cast(Setup, ours)) is Driving.BY_SLIDER
    assert _who_obeys(cast(Setup, theirs)) is Driving.NOBODY, "it drives the arm of another cell"
