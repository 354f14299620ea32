"""The live synchroniser among faulty cameras: the twin goes on, and each fault is named with its camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from twin_node.messages import convert
from twin_node.messages.convert import Level
from twin_node.nodes import synchronizer
from twin_node.nodes.live.rig_source import RigParameters, topics_of
from twin_node.nodes.synchronizer import SynchronizerNode, SynchronizerParameters
from twin_node.nodes.topics import FRAMES, JOINT_STATES
from twin_node.runtime.bus import LocalBus
from twin_node.scene import FrameSet, JointSample, Rig, RigCamera

MS = 1_000_000
PERIOD = 33 * MS
START = 1_700_000_000_000 * MS
NAMES = ("back", "front", "left")
ARM = ("shoulder", "elbow")
SECOND = 30
"""Images of a second."""


class Clock:
    def __init__(self) -> None:
        self.stamp = START

    def now(self) -> int:
        return self.stamp


class Alarm:
    """Rings when the test has let its time come."""

    def __init__(self, clock: Clock, callback: Callable[[], None]) -> None:
        self._clock, self._callback = clock, callback
        self.due: int | None = None

    def set(self, delay_s: float) -> None:
        self.due = self._clock.stamp + round(delay_s * 1e9)

    def ring(self) -> None:
        self.due = None
        self._callback()


class Timers:
    """Alarms in a time of the test's own."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.alarms: list[Alarm] = []

    def alarm(self, callback: Callable[[], None]) -> Alarm:
        self.alarms.append(Alarm(self._clock, callback))
        return self.alarms[-1]


@dataclass(frozen=True)
class Fault:
    """What is wrong with one camera from the second second on."""

    stamp_shift: int = 0
    arrival_delay: int = 0
    keeps: Callable[[int], bool] = lambda i: True
    spoils: Callable[[Any], None] = lambda message: None
    """Changes the image message."""


class Cell:
    """Three cameras and a live synchroniser in a time of the test's own."""

    def __init__(self, parameters: SynchronizerParameters | None = None, apart: int = MS, period: int = PERIOD) -> None:
        """`apart`: between the exposures of a camera and the next, ns."""
        self._apart, self._period = apart, period
        K = np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])
        rig = Rig(tuple(RigCamera(name, 16, 12, K, np.eye(4)) for name in NAMES))
        parameters = parameters or SynchronizerParameters()
        self.topics = {name: topics_of(name, RigParameters(image="image_raw")) for name in NAMES}
        self.bus, self.clock = LocalBus(), Clock()
        self.timers = Timers(self.clock)
        cameras = tuple(self.topics.values())
        self.node = SynchronizerNode(self.bus, self.clock, cameras, rig, parameters, self.timers, ARM)
        self.node.configure()
        self.sets: list[FrameSet] = []
        self.bus.subscribe(FRAMES, self.sets.append)

    def run(self, first: int, count: int, **faults: Fault) -> None:
        """Images `first` to `first + count` of every camera, in the order of their arrival; timers in between."""
        for arrival, stamp, name in sorted(self._arrivals(first, count, faults)):
            self._pass_time(arrival)
            message = convert.raw_image(name, stamp, np.full((12, 16, 3), 90, np.uint8))
            faults.get(name, Fault()).spoils(message)
            self.bus.publish(self.topics[name].image, message)

    def _pass_time(self, until: int) -> None:
        """Lets the clock run to a time, ns, and alarms ring on the way."""
        while due := [alarm for alarm in self.timers.alarms if alarm.due is not None and alarm.due <= until]:
            first = min(due, key=lambda alarm: alarm.due or 0)
            self.clock.stamp = max(self.clock.stamp, first.due or 0)
            first.ring()
        self.clock.stamp = until

    def _arrivals(self, first: int, count: int, faults: dict[str, Fault]) -> Iterator[tuple[int, int, str]]:
        for i in range(first, first + count):
            for place, name in enumerate(NAMES):
                fault = faults.get(name, Fault())
                if fault.keeps(i):
                    taken = START + i * self._period + place * self._apart
                    yield taken + 5 * MS + fault.arrival_delay, taken + fault.stamp_shift, name

    def said(self) -> dict[str, tuple[Level, str]]:
        """What the diagnostics say of each camera since the last call."""
        return {d.hardware: (d.level, d.message) for d in self.node.diagnoses()}


@pytest.fixture(autouse=True)
def few_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(synchronizer, "thread_count", lambda: synchronizer.MODEL_THREADS)


@pytest.fixture(params=["decoded here", "decoded beside"])
def cell(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Cell:
    if request.param == "decoded beside":
        monkeypatch.setattr(synchronizer, "thread_count", lambda: synchronizer.MODEL_THREADS + 1)
    cell = Cell()
    cell.run(0, SECOND)
    assert {level for level, _ in cell.said().values()} == {Level.OK}
    return cell


def others_are_well(cell: Cell, camera: str) -> tuple[Level, str]:
    said = cell.said()
    assert all(said[name][0] is Level.OK for name in NAMES if name != camera)
    return said[camera]


def test_a_dead_camera_costs_one_deadline_and_is_named(cell: Cell) -> None:
    before = len(cell.sets)
    cell.run(SECOND, SECOND, front=Fault(keeps=lambda i: False))
    level, message = others_are_well(cell, "front")
    assert (level, message.partition(":")[0]) == (Level.ERROR, "silent")
    made = cell.sets[before:]
    assert len(made) >= SECOND - 5
    assert all(len(frames.views) == 2 for frames in made[4:])
    waits = np.diff([frames.stamp for frames in made])
    assert (waits > 0).all()


def test_a_twin_that_sees_nothing_is_not_said_to_go_on(cell: Cell) -> None:
    said = cell.said()
    assert set(said) == set(NAMES)
    for level, message in said.values():
        assert level is Level.ERROR and message.endswith("nor of any other camera: the twin waits")
    cell.run(SECOND, SECOND, front=Fault(keeps=lambda i: False))
    assert others_are_well(cell, "front")[1].endswith("the twin goes on without it")


def test_the_last_images_before_silence_leave_by_the_timer(cell: Cell) -> None:
    """When all cameras but one fall silent at once no image comes to look at the deadline: only the timer does."""
    cell.run(SECOND, 1, front=Fault(keeps=lambda i: False))
    last, before = cell.clock.stamp, len(cell.sets)
    due = cell.timers.alarms[0].due
    assert due is not None
    assert last < due <= last + 100 * MS
    cell._pass_time(due - 1)
    assert len(cell.sets) == before
    cell._pass_time(due)
    assert len(cell.sets) > before


def cut(message: Any) -> None:
    message.data = message.data[:10]


def shrink(message: Any) -> None:
    message.height, message.data = 6, message.data[: 6 * message.step]


@pytest.mark.parametrize(("spoils", "words"), [(cut, "10 bytes"), (shrink, "expected 8-bit colour images of 16x12")])
def test_a_camera_whose_images_are_no_good_is_left_out_and_named(
    cell: Cell, spoils: Callable[[Any], None], words: str
) -> None:
    before = len(cell.sets)
    cell.run(SECOND, SECOND, front=Fault(spoils=spoils))
    level, message = others_are_well(cell, "front")
    assert level is Level.WARN
    assert message.startswith("unusable: ")
    assert words in message
    made = cell.sets[before:]
    assert len(made) >= SECOND - 2
    assert all([view.camera.name for view in frames.views] == ["back", "left"] for frames in made[1:])
    assert (np.diff([frames.stamp for frames in made]) > 0).all()


def test_a_spoilt_image_that_leaves_by_the_timer_ends_nothing(cell: Cell) -> None:
    """The timer's callback is no subscription, whose errors are counted: what it raises ends the process."""
    cell.run(SECOND, 1, front=Fault(keeps=lambda i: False), left=Fault(spoils=cut))
    due, before = cell.timers.alarms[0].due, len(cell.sets)
    assert due is not None
    cell._pass_time(due)
    assert [[view.camera.name for view in frames.views] for frames in cell.sets[before:]] == [["back"]]
    assert "unusable: 1 image" in cell.said()["left"][1]


def test_a_camera_at_half_rate_is_named(cell: Cell) -> None:
    before = len(cell.sets)
    cell.run(SECOND, SECOND, left=Fault(keeps=lambda i: i % 2 == 0))
    level, message = others_are_well(cell, "left")
    assert (level, message) == (Level.WARN, "slow: 15 images where the fastest camera sent 30")
    assert len(cell.sets) - before >= SECOND // 2 - 2


def test_a_camera_whose_images_are_late_is_named(cell: Cell) -> None:
    before = len(cell.sets)
    cell.run(SECOND, SECOND, back=Fault(arrival_delay=40 * MS))
    level, message = others_are_well(cell, "back")
    assert level is Level.WARN
    assert "images arrive 40 ms later" in message
    assert sum(len(frames.views) == 3 for frames in cell.sets[before:]) >= SECOND - 5


@pytest.mark.parametrize(("shift", "word"), [(1_000 * MS, "future"), (-1_000 * MS, "late")])
def test_a_clock_that_steps_is_named_and_taken_back(cell: Cell, shift: int, word: str) -> None:
    before = len(cell.sets)
    cell.run(SECOND, SECOND, front=Fault(stamp_shift=shift))
    level, message = others_are_well(cell, "front")
    assert level is Level.WARN
    assert f"{word}: " in message
    assert len(cell.sets) - before >= SECOND - 6
    cell.run(2 * SECOND, 2 * SECOND)
    cell.said()
    cell.run(4 * SECOND, SECOND)
    assert cell.said()["front"][0] is Level.OK
    assert len(cell.sets[-1].views) == 3


def test_cameras_whose_images_are_too_far_apart_for_a_set_are_named() -> None:
    """Three at 10 Hz that run free: no set came, and all of them were said to be in step."""
    cell = Cell(apart=33 * MS, period=100 * MS)
    cell.run(0, SECOND)
    cell.said()
    cell.run(SECOND, SECOND)
    assert cell.sets == []
    for level, message in cell.said().values():
        assert level is Level.WARN
        assert "in no set: 30 images came when the other cameras' were too far away" in message


@pytest.mark.parametrize(
    ("late", "frame", "said"),
    [
        (16 * MS, "front_optical_frame", "no depth: it came with 0 of 30 images"),
        (0, "front_depth_optical_frame", "depth of another lens: it is of 'front_depth_optical_frame', the image of"),
        (0, "/front_optical_frame", "in step with the others"),
    ],
)
def test_depth_that_comes_with_other_stamps_or_of_another_frame_is_named(late: int, frame: str, said: str) -> None:
    K = np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])
    topics = topics_of("front", RigParameters(image="image_raw", depth="depth/image_rect"))
    bus, clock = LocalBus(), Clock()
    rig = Rig((RigCamera("front", 16, 12, K, np.eye(4)),))
    node = SynchronizerNode(bus, clock, (topics,), rig, SynchronizerParameters(), Timers(clock))
    node.configure()
    for i in range(SECOND):
        stamp = START + i * PERIOD
        clock.stamp = stamp + 5 * MS
        bus.publish(topics.image, convert.raw_image("front", stamp, np.full((12, 16, 3), 90, np.uint8)))
        depth = convert.depth_image("front", stamp + late, np.ones((12, 16), np.float32))
        depth.header.frame_id = frame
        bus.publish(topics.depth or "", depth)
    assert said in node.diagnoses()[0].message


def test_duplicates_are_counted_and_named(cell: Cell) -> None:
    cell.run(SECOND, 3)
    image = convert.raw_image("left", START + (SECOND + 2) * PERIOD + 2 * MS, np.zeros((12, 16, 3), np.uint8))
    cell.bus.publish(cell.topics["left"].image, image)
    assert "duplicate: 1 image" in cell.said()["left"][1]


def test_of_two_images_with_one_stamp_the_first_is_shown_as_in_lockstep(cell: Cell) -> None:
    """The second is refused: what was decoded of it while the set was not whole must not be shown either."""
    for i in range(SECOND, SECOND + 10):
        stamp = START + i * PERIOD
        cell._pass_time(stamp + 5 * MS)
        for name, value in (("back", 50), ("back", 200), ("front", 50), ("left", 50)):
            image = convert.raw_image(name, stamp, np.full((12, 16, 3), value, np.uint8))
            cell.bus.publish(cell.topics[name].image, image)
    assert "duplicate: 10 images" in cell.said()["back"][1]
    assert [frames.views[0].rgb.max() for frames in cell.sets[-8:]] == [50] * 8


def test_joints_of_a_gripper_are_not_taken_for_the_arms(cell: Cell) -> None:
    """It publishes on the same topic, nearer to the images' stamps than the arm does."""
    before = len(cell.sets)
    for i in range(SECOND, SECOND + 10):
        stamp = START + i * PERIOD
        for names, at in ((ARM, stamp + 4 * MS), (("finger_joint",), stamp + 2 * MS), (("shoulder",), stamp + 2 * MS)):
            sample = JointSample(at, names, np.zeros(len(names)), np.zeros(len(names)))
            cell.bus.publish(JOINT_STATES, convert.joint_sample_to_message(sample))
        cell.run(i, 1)
    found = [frames.joints for frames in cell.sets[before:]]
    assert len(found) >= 8
    assert [joints.names for joints in found if joints is not None] == [ARM] * len(found)


def test_images_stamped_after_their_arrival_are_named_before_they_are_refused(cell: Cell) -> None:
    """A clock that is ahead by less than what is refused makes every forecast look less far than it says."""
    before = len(cell.sets)
    ahead = {name: Fault(stamp_shift=60 * MS) for name in NAMES}
    cell.run(SECOND, SECOND, **ahead)
    assert len(cell.sets) - before >= SECOND - 6
    said = cell.said()
    assert set(said) == set(NAMES)
    for level, message in said.values():
        assert level is Level.WARN
        assert message.startswith("ahead: images are stamped 55 ms after their arrival; let chrony or PTP keep")


@pytest.mark.parametrize(("behind_ms", "seconds"), [(3_600_000, "3600.0"), (500, "0.5")])
def test_cameras_whose_clocks_are_all_behind_are_named(cell: Cell, behind_ms: int, seconds: str) -> None:
    """Of one computer without time service: they are in step with each other, and the arm stands for old evidence."""
    behind = {name: Fault(stamp_shift=-behind_ms * MS) for name in NAMES}
    cell.run(SECOND, SECOND, **behind)
    said = cell.said()
    assert set(said) == set(NAMES)
    for level, message in said.values():
        assert level is Level.WARN
        assert f"old: images are stamped {seconds} s before their arrival; let chrony or PTP keep" in message


def test_a_camera_whose_depth_fails_is_named_and_costs_no_latency() -> None:
    K = np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])
    rig = Rig(tuple(RigCamera(name, 16, 12, K, np.eye(4)) for name in NAMES))
    topics = {name: topics_of(name, RigParameters(image="image_raw", depth="depth/image_rect")) for name in NAMES}
    bus, clock, sets = LocalBus(), Clock(), list[FrameSet]()
    node = SynchronizerNode(bus, clock, tuple(topics.values()), rig, SynchronizerParameters(), Timers(clock))
    node.configure()
    bus.subscribe(FRAMES, sets.append)

    def take(i: int, *measuring: str, metres: float = 1.0) -> None:
        clock.stamp = START + i * PERIOD + 5 * MS
        for name in NAMES:
            stamp = START + i * PERIOD
            bus.publish(topics[name].image, convert.raw_image(name, stamp, np.full((12, 16, 3), 90, np.uint8)))
            if name in measuring:
                depth = np.full((12, 16), metres, np.float32)
                bus.publish(topics[name].depth or "", convert.depth_image(name, stamp, depth))

    for i in range(SECOND):
        take(i, "front", "left")
    assert [d.message for d in node.diagnoses()] == ["in step with the others"] * 3
    for i in range(SECOND, 2 * SECOND):
        take(i, "front")
    assert sets[-1].stamp == START + (2 * SECOND - 1) * PERIOD
    assert [view.depth is not None for view in sets[-1].views] == [False, True, False]
    back, front, left = node.diagnoses()
    assert (back.level, front.level, left.level) == (Level.OK, Level.OK, Level.WARN)
    assert "no depth: it came with 0 of 30 images; look at the depth camera" in left.message
    for i in range(2 * SECOND, 3 * SECOND):  # what comes, and was measured nowhere, is none
        take(i, "front", metres=0.0)
    assert "no depth: it came with 0 of 30 images" in node.diagnoses()[1].message


@pytest.mark.parametrize("rate", [None, 15.0])
def test_images_are_decoded_as_they_come_and_only_those_of_sets_that_are_taken(
    rate: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = Cell(SynchronizerParameters(max_rate_hz=rate))
    events: list[str] = []
    decode = convert.rgb_from_message
    monkeypatch.setattr(convert, "rgb_from_message", lambda message: (events.append("d"), decode(message))[1])
    for topics in cell.topics.values():
        cell.bus.subscribe(topics.image, lambda _: events.append("."))
    cell.run(0, SECOND)
    known = "".join(events)[len(events) // 2 :]  # by then it has learnt how the cameras lie to each other
    taken, skipped = "d.d.d.", "..." if rate else ""
    assert known in (taken + skipped) * SECOND
    assert len(cell.sets) > SECOND / 3


def test_of_a_camera_that_is_faster_than_the_others_half_is_not_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, decoded, decode = Cell(), list[int](), convert.rgb_from_message
    monkeypatch.setattr(convert, "rgb_from_message", lambda message: (decoded.append(1), decode(message))[1])
    slow = Fault(keeps=lambda i: i % 4 == 0)
    cell.run(0, SECOND, back=slow, left=slow)
    del decoded[:]
    before = len(cell.sets)
    cell.run(SECOND, 4 * SECOND, back=slow, left=slow)
    made = len(cell.sets) - before
    assert made >= SECOND - 2
    assert 3 * made <= len(decoded) <= 4 * made + 4
