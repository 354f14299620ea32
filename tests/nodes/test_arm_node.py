"""The arm's node: its reaction covers the time until the next decision, and no more than its deadline."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from twin_logs import START, obstacles_at

from twin_node.arm import ArmCollisionChecker, default_path
from twin_node.errors import TwinError
from twin_node.messages import convert
from twin_node.nodes import arm as arm_node
from twin_node.nodes.arm import GAPS_KEPT, HEARD_NS, ArmNode, make_arm_node
from twin_node.nodes.arm_parameters import ArmParameters
from twin_node.nodes.live.beside_twin import make_arm
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import JOINT_STATES, OBSTACLES, SEPARATION, TRAJECTORY
from twin_node.robot import forward_kinematics, ur_model
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.runtime.parameters import fill
from twin_node.scene import Float64, JointPath, JointSample, ObstacleKind, Obstacles, ObstacleShape, Separation

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


MS = 1_000_000
MODEL = ur_model("ur5e")
READY = np.array([0.0, -1.5, 1.5, -1.5, -1.57, 0.0])
TURNING = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
"""rad/s: the arm sweeps to its left."""
WORKSPACE = np.array([[0.1, -0.6, 0.0], [0.8, 0.6, 0.5]])
"""Corners, m."""


class Cell:
    """An arm's node, its clock, and somebody 28 cm to the left of the tool: an arm that turns there slows."""

    def __init__(self, timers: Timers | None = None, **given: object) -> None:
        """`given`: parameters of the arm as they stand in a file."""
        self.bus, self.clock = LocalBus(), SteppedClock(START)
        self.told: list[Separation] = []
        self.bus.subscribe(SEPARATION, lambda message: self.told.append(convert.separation_from_message(message)))
        parameters = fill(ArmParameters, {"model": "ur5e", "max_obstacles": 8, **given}, "arm")
        self.node = make_arm_node(self.bus, self.clock, WORKSPACE, parameters, timers)
        self.node.configure()

    def wait(self, milliseconds: int) -> None:
        self.clock.advance_to(self.clock.now() + milliseconds * MS)

    def joints(self, q: Float64 = READY, qd: Float64 = TURNING, ago_ms: int = 0, has_velocities: bool = True) -> None:
        sample = JointSample(self.clock.now() - ago_ms * MS, MODEL.joint_names, q, qd)
        message = convert.joint_sample_to_message(sample)
        if not has_velocities:
            message.velocity = np.zeros(0)
        self.bus.publish(JOINT_STATES, message)

    def gripper(self) -> None:
        sample = JointSample(self.clock.now(), ("finger_joint",), np.zeros(1), np.zeros(1))
        self.bus.publish(JOINT_STATES, convert.joint_sample_to_message(sample))

    def path(self, begins_ms: int, lasts_ms: int, velocity: Float64 = TURNING) -> None:
        seconds = np.linspace(0, lasts_ms * 1e-3, 11)
        stamps = self.clock.now() + begins_ms * MS + np.rint(seconds * 1e9).astype(np.int64)
        path = JointPath(MODEL.joint_names, stamps, READY + seconds[:, None] * velocity)
        self.bus.publish(TRAJECTORY, convert.joint_path_to_message(path))

    def somebody(
        self,
        count: int = 1,
        begins_ms: int = 0,
        ahead_ms: int = 0,
        frame: str = "base_link",
        at: Float64 | None = None,
        kind: ObstacleKind = ObstacleKind.MOVING,
    ) -> Separation:
        """Obstacles, now (or stamped ahead), foreseen from so much later on; gives back what the arm is told."""
        now = self.clock.now() + ahead_ms * MS
        beside = forward_kinematics(MODEL, READY)[-1, :3, 3] + np.array([0.0, 0.33, 0.0])
        obstacles = Obstacles(
            stamp=now,
            ids=np.arange(count, dtype=np.uint32),
            kinds=np.full(count, kind, np.uint8),
            shapes=np.full(count, ObstacleShape.SPHERE, np.uint8),
            positions=np.tile(beside if at is None else at, (count, 1)),
            quats=np.tile([1.0, 0, 0, 0], (count, 1)),
            sizes=np.full((count, 3), 0.1),
            velocities=np.zeros((count, 3)),
            bounds=np.zeros(count),
            valid_from=np.full(count, now + begins_ms * MS),
            valid_to=np.full(count, now + (begins_ms + 200) * MS),
        )
        message = convert.obstacles_to_message(obstacles)
        message.header.frame_id = frame
        self.bus.publish(OBSTACLES, message)
        return self.told[-1]


def test_an_arm_whose_joints_come_without_velocities_is_known_to_move() -> None:
    cell = Cell()
    for i in range(20):
        cell.joints(READY + TURNING * (i - 20) * 0.008, has_velocities=False)
        cell.wait(8)
    assert cell.somebody().reason == "slow for MOVING"


def test_joints_that_have_stopped_coming_stop_the_arm_and_it_says_so() -> None:
    cell = Cell()
    cell.joints(qd=np.zeros(6))
    assert cell.somebody().reason == "clear"
    cell.wait(390)
    assert cell.somebody().reason == "clear"
    cell.wait(20)
    told = cell.somebody()
    assert (told.speed_fraction, told.reason) == (0.0, "stopped: the arm's joints are 410 ms old")
    cell.joints(ago_ms=-500)
    assert cell.somebody().reason == "stopped: the arm's joints are 500 ms in the future"
    cell.joints(qd=np.zeros(6), ago_ms=0)
    assert cell.somebody().reason == "clear"


def test_a_gripper_that_publishes_its_own_joints_beside_the_arms_changes_nothing() -> None:
    cell = Cell()
    cell.gripper()
    cell.joints()
    cell.gripper()
    assert cell.somebody().reason == "slow for MOVING"


def test_joints_of_another_arm_alone_are_refused_by_name() -> None:
    cell = Cell()
    cell.gripper()
    with pytest.raises(TwinError, match="found finger_joint"):
        cell.somebody()


def test_joints_that_come_late_do_not_replace_newer_ones() -> None:
    cell = Cell()
    cell.joints()
    cell.joints(qd=np.zeros(6), ago_ms=30)
    assert cell.somebody().reason == "slow for MOVING"


def test_a_path_that_has_not_begun_or_is_over_does_not_say_where_the_arm_is() -> None:
    cell = Cell()
    cell.joints()
    cell.path(begins_ms=300, lasts_ms=200)
    assert cell.somebody().reason == "slow for MOVING"  # the path alone would have it stand
    cell.path(begins_ms=-201, lasts_ms=200, velocity=np.zeros(6))
    assert cell.somebody().reason == "slow for MOVING"
    cell.path(begins_ms=-100, lasts_ms=200, velocity=np.zeros(6))
    assert cell.somebody().reason == "clear"


@pytest.mark.parametrize(("begun_ms", "begins_ms"), [(199, 0), (5, 194), (5, 350)])
def test_an_arm_does_not_stand_where_its_path_is_told_no_further(begun_ms: int, begins_ms: int) -> None:
    """A driver tells of 200 ms; the joints of an arm that is slowed say less than what its program means to do."""
    cell = Cell()
    cell.joints(qd=0.02 * TURNING)
    cell.path(begins_ms=-begun_ms, lasts_ms=200)
    assert "for MOVING" in cell.somebody(begins_ms=begins_ms).reason


def test_a_log_whose_recording_times_lie_before_its_stamps_is_judged_by_its_stamps() -> None:
    cell = Cell()
    cell.joints(ago_ms=-900)
    assert cell.somebody(ahead_ms=900).reason == "slow for MOVING"


def test_who_has_heard_of_an_arm_never_judges_a_made_up_one() -> None:
    cell = Cell()
    assert [d.level for d in cell.node.diagnoses()] == [convert.Level.WARN]
    cell.path(begins_ms=0, lasts_ms=200)
    assert [d.level for d in cell.node.diagnoses()] == [convert.Level.OK]
    cell.wait(500)
    assert cell.somebody().reason == "stopped: the arm's trajectory is over, and no joints come"
    cell.path(begins_ms=500, lasts_ms=200)
    assert cell.somebody().reason == "stopped: the arm's trajectory has not begun, and no joints come"


def test_a_path_that_is_not_finite_is_refused_when_it_comes() -> None:
    cell = Cell()
    cell.joints()
    with pytest.raises(TwinError, match="finite"):
        cell.path(begins_ms=0, lasts_ms=200, velocity=TURNING * np.nan)
    assert cell.somebody().reason == "slow for MOVING"


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


@pytest.mark.parametrize("value", [-1.0, math.nan])
def test_a_command_cannot_arrive_before_it_is_sent(value: float) -> None:
    with pytest.raises(TwinError, match=f"command_latency_ms: expected a number of 0 or more, found {value:g}"):
        ArmParameters(command_latency_ms=value)


@pytest.mark.parametrize("frame", ["base", "world", ""])
def test_obstacles_in_another_frame_are_refused(frame: str) -> None:
    """In `base`, half a turn about z away, whoever stands before the arm would be held for behind it."""
    cell = Cell()
    cell.joints()
    with pytest.raises(TwinError, match=f"expected them in base_link, found {frame!r}"):
        cell.somebody(frame=frame)
    assert cell.somebody(frame="/base_link").reason == "slow for MOVING"


def obeying(cell: Cell, q: Float64, periods: int) -> Float64:
    """Joints at 125 Hz from `q` on, forecasts every 32 ms of somebody in the arm's way; gives back its last joints."""
    at = forward_kinematics(MODEL, READY + 1.5 * TURNING)[-1, :3, 3]
    for i in range(periods):
        cell.wait(8)
        share = cell.told[-1].speed_fraction if cell.told else 0.0
        q = q + TURNING * share * 0.008
        cell.joints(q, TURNING * share)
        if i % 4 == 0:
            cell.somebody(at=at)
    return q


def test_an_arm_of_which_only_joints_are_known_does_not_creep_up_to_who_stands_in_its_way() -> None:
    """Stopped, it seemed to close in on nobody, and was told to go on until it moved: 4 % of its speed every 66 ms."""
    cell = Cell(Timers())
    stopped = obeying(cell, READY, 300)
    assert cell.told[-1].reason == "stopped for MOVING"
    np.testing.assert_array_equal(obeying(cell, stopped, 300), stopped)


def test_an_arm_that_is_led_by_hand_or_obeys_nobody_is_judged_as_it_moves() -> None:
    cell = Cell(Timers())
    stopped = obeying(cell, READY, 400)
    at = forward_kinematics(MODEL, READY + 1.5 * TURNING)[-1, :3, 3]
    for _ in range(30):
        cell.wait(8)
        cell.joints(stopped, -0.3 * TURNING)
    assert cell.somebody(at=at).reason in ("clear", "not closing in")


def made(arm: dict[str, str], driver: dict[str, str]) -> ArmNode:
    """The arm's node of a launch file with these sections."""
    sections = {"/**": {"rig": {"scenario": "demo"}}, "arm": arm, "ur_driver": driver}
    bus, clock = LocalBus(), SteppedClock(START)
    setup = Setup("arm", bus, clock, Timers(), sections, "cell.yaml", lambda: None, tuple)  # type: ignore[arg-type]
    return make_arm(setup)


def test_the_arm_that_is_judged_is_the_one_that_is_driven() -> None:
    """Their joints have the same names: nothing else would tell that distances are those of another arm."""
    with pytest.raises(TwinError, match=r"cell.yaml: arm.model: expected the arm that is driven, ur5e, found ur10e"):
        made({}, {"robot": "192.168.1.10"})
    with pytest.raises(TwinError, match="expected the arm that is driven, ur3e, found ur5e"):
        made({"model": "ur5e"}, {"robot": "192.168.1.10", "model": "ur3e"})
    assert made({"model": "ur5e"}, {"robot": "192.168.1.10"}) is not None
    assert made({"model": "sim/ur5e.xml"}, {"robot": "192.168.1.10"}) is not None  # with a gripper, perhaps
    assert made({"model": "ur10e"}, {"robot": ""}) is not None  # none is driven


def test_a_cover_of_more_obstacles_can_be_given_room() -> None:
    """As many as 'obstacles: most_static' and the like may ask for: the error tells to raise it."""
    parameters = fill(ArmParameters, {"model": "ur5e", "max_obstacles": 9}, "arm")
    bus, clock = LocalBus(), SteppedClock(START)
    node = make_arm_node(bus, clock, np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]]), parameters)
    node.configure()
    cell = Cell()
    cell.bus, cell.node = bus, node
    bus.subscribe(SEPARATION, lambda message: cell.told.append(convert.separation_from_message(message)))
    cell.joints()
    assert cell.somebody(count=9).reason == "slow for MOVING"
    with pytest.raises(TwinError, match="expected at most 9 of a shape, found 10; raise max_obstacles"):
        cell.somebody(count=10)
    with pytest.raises(TwinError, match="max_obstacles: expected a number of 1 or more, found 0"):
        ArmParameters(max_obstacles=0)


def test_a_tool_of_the_parameters_is_kept_away_too() -> None:
    """A gripper that no parameter could tell of reached 16 cm farther than the law knew."""
    gripper = {"start": [0.0, 0.0, 0.045], "end": [0.0, 0.0, 0.25], "radius": 0.045}
    tip = forward_kinematics(MODEL, READY)[-1] @ np.array([0.0, 0.0, 0.25, 1.0])
    distances = []
    for tool in ([], [gripper]):
        cell = Cell(tool=tool)
        cell.joints()
        distances.append(cell.somebody(at=tip[:3] + np.array([0.0, 0.3, 0.0])).distance)
    assert distances[1] == pytest.approx(0.3 - 0.045 - 0.05, abs=0.1)
    assert distances[1] < distances[0] - 0.05


@pytest.mark.parametrize(
    "wrong",
    [{"radius": 0.0}, {"radius": math.inf}, {"end": [0.0, 0.0, math.inf]}, {"radius": 45.0}, {"start": [45.0, 0, 0]}],
)
def test_a_tool_that_is_none_is_refused(wrong: dict[str, Any]) -> None:
    tool = {"start": [0.0, 0.0, 0.0], "end": [0.0, 0.0, 0.1], "radius": 0.05, **wrong}
    with pytest.raises(TwinError, match="tool: expected ends and a radius in metres"):
        fill(ArmParameters, {"tool": [tool]}, "arm")


def test_what_stands_may_be_touched_where_it_is_allowed() -> None:
    """An arm at its table had no parameter that let it near, and beside its own unseen shadow it stood for ever."""
    tool = forward_kinematics(MODEL, READY)[-1, :3, 3]
    box = {"lower": (tool - 0.2).tolist(), "upper": (tool + 0.2).tolist()}
    for kind in (ObstacleKind.STATIC, ObstacleKind.UNSEEN, ObstacleKind.MOVING):
        touched = []
        for allowed in ([], [{**box, "links": ["forearm_link"]}], [box]):
            cell = Cell(allowed=allowed)
            cell.joints()
            touched.append(cell.somebody(at=tool, kind=kind).distance <= 0)
        assert touched == [True, True, kind == ObstacleKind.MOVING]


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"lower": [1.0, 0.0, 0.0]}, "allowed: expected a lower corner below the upper one in metres"),
        ({"upper": [500.0, 500.0, 500.0]}, "allowed: expected a lower corner below the upper one in metres"),
        ({"links": ["wrist_9_link"]}, "allowed: expected links of shoulder_link, .*, found 'wrist_9_link'"),
    ],
)
def test_a_region_that_is_none_is_refused(wrong: dict[str, Any], words: str) -> None:
    box = {"lower": [0.0, 0.0, 0.0], "upper": [0.5, 0.5, 0.5], **wrong}
    with pytest.raises(TwinError, match=words):
        parameters = fill(ArmParameters, {"model": "ur5e", "allowed": [box]}, "arm")
        make_arm_node(LocalBus(), SteppedClock(START), WORKSPACE, parameters)
