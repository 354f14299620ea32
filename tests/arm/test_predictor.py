"""What is known of where the arm is: a path while the joints are on it, else the joints."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.arm import ArmError, ArmPredictor, CyclicPath, default_path
from twin_node.robot import RobotError, ur_model
from twin_node.scene import Float64, JointPath, JointSample

MODEL = ur_model("ur5e")
MS = 1_000_000
NOW = 1_700_000_000_000_000_000
READY = np.array([0.0, -1.8, 1.9, -1.7, -1.57, 0.0])
TURNING = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
"""rad/s."""


def unwanted() -> CyclicPath:
    raise AssertionError("nobody looks for a made-up arm here")


def planned(begins_ms: int = 0, lasts_ms: int = 4000, velocity: Float64 = TURNING) -> JointPath:
    """From `READY` on, so many ms after `NOW`."""
    stamps = NOW + begins_ms * MS + np.array([0, lasts_ms * MS])
    return JointPath(MODEL.joint_names, stamps, np.stack([READY, READY + lasts_ms * 1e-3 * velocity]))


def joints(at: Float64, velocity: Float64, when_ms: int) -> JointSample:
    return JointSample(NOW + when_ms * MS, MODEL.joint_names, at, velocity)


def predictor(path: JointPath, sample: JointSample | None = None) -> ArmPredictor:
    found = ArmPredictor(MODEL, unwanted, 0.4)
    found.take_path(path)
    if sample is not None:
        found.take_joints(sample)
    return found


def pose_at(found: ArmPredictor, when_ms: int) -> Float64:
    """Where the arm is said to be, [J] rad."""
    stamp = NOW + when_ms * MS
    pose: Float64 = found.ahead(stamp, stamp).positions[0]
    return pose


def test_an_arm_that_is_held_back_is_judged_where_it_stands_and_not_where_it_was_planned_to_be() -> None:
    found = predictor(planned(), joints(READY, 0 * TURNING, 2000))
    np.testing.assert_allclose(pose_at(found, 2000), READY)
    assert found.stray_rad == pytest.approx(1.9)  # of what it may lag at most


@pytest.mark.parametrize(
    ("stamps", "rows", "said"), [([], 0, "at least one row"), ([5, 5], 2, "increasing stamps"), ([5, 6, 7], 2, "found")]
)
def test_a_path_that_is_none_is_refused_when_it_comes(stamps: list[int], rows: int, said: str) -> None:
    """It took the place of the one before, and one without samples ended in a trace when the arm was looked for."""
    found = predictor(planned())
    with pytest.raises(ArmError, match=f"joint path: expected .*{said}"):
        found.take_path(JointPath(MODEL.joint_names, NOW + np.array(stamps, np.int64), np.zeros((rows, 6))))
    np.testing.assert_allclose(pose_at(found, 1000), READY + TURNING)


def test_a_path_that_was_left_once_is_not_come_back_to() -> None:
    """An arm that comes by where its path would have it by now may be on its way anywhere."""
    found = predictor(planned(), joints(READY, 0 * TURNING, 500))
    pose_at(found, 500)
    found.take_joints(joints(READY + TURNING, -TURNING, 1000))
    ahead = found.ahead(NOW + 1000 * MS, NOW + 1000 * MS)
    assert ahead.positions[-1, 0] < ahead.positions[0, 0]
    found.take_path(planned(begins_ms=0))
    assert found.stray_rad is None
    ahead = found.ahead(NOW + 1000 * MS, NOW + 1000 * MS)
    assert ahead.positions[-1, 0] > ahead.positions[0, 0]


@pytest.mark.parametrize("lag_ms", [-95, -40, 0, 40, 95])
def test_an_arm_that_lags_behind_its_path_or_leads_it_a_little_is_on_it(lag_ms: int) -> None:
    found = predictor(planned(), joints(READY + (1.0 - lag_ms * 1e-3) * TURNING, TURNING, 1000))
    np.testing.assert_allclose(pose_at(found, 1000), READY + TURNING)
    assert found.stray_rad is None


@pytest.mark.parametrize("joint", range(6))
def test_every_joint_must_be_on_the_path(joint: int) -> None:
    off = 0.06 * (np.arange(6) == joint)
    found = predictor(planned(velocity=0 * TURNING), joints(READY + off, 0 * TURNING, 1000))
    np.testing.assert_allclose(pose_at(found, 1000), READY + off)
    near = predictor(planned(velocity=0 * TURNING), joints(READY + off / 2, 0 * TURNING, 1000))
    np.testing.assert_allclose(pose_at(near, 1000), READY)


def test_joints_that_were_heard_a_little_before_the_path_begins_do_not_contradict_it() -> None:
    """A driver tells of the next 200 ms by joints that it has just heard of."""
    fast = 3 * TURNING
    before = joints(READY - 0.02 * fast, fast, -20)
    found = predictor(planned(velocity=fast, lasts_ms=200), before)
    np.testing.assert_allclose(pose_at(found, 10), READY + 0.01 * fast)
    assert found.stray_rad is None


def test_joints_from_before_the_path_begins_go_on_at_the_speed_that_was_measured() -> None:
    """Not at their program's: of an arm held to a quarter that would be 10 cm instead of 2.5."""
    found = predictor(planned(velocity=0 * TURNING, lasts_ms=200))
    found.take_joints(joints(READY, 0.5 * TURNING, -50), share=0.25)
    pose_at(found, 10)
    assert found.stray_rad is None


def test_joints_that_are_told_within_half_a_turn_neither_jump_nor_leave_their_path() -> None:
    """A wrist that passed half a turn was taken to turn back at its rating, and to be a whole turn off its path."""
    wrist = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    before, after = READY + (np.pi - 0.01) * wrist, READY + (0.01 - np.pi) * wrist
    found = predictor(planned(velocity=wrist))
    for at, when_ms in ((before, 3132), (after, 3152)):
        found.take_joints(joints(at, 0 * wrist, when_ms), has_velocities=False)
        assert pose_at(found, when_ms)[5] == pytest.approx(when_ms * 1e-3, abs=1e-6)
    assert found.stray_rad is None
    found.leave_path()
    stamp = NOW + 3152 * MS
    ahead = found.ahead(stamp, stamp).positions[:, 5]
    np.testing.assert_allclose(ahead - after[5], np.linspace(0, 0.2, 21), atol=1e-6)


@pytest.mark.parametrize("gap_ms", [0, 4])
def test_two_arms_under_the_same_names_are_neither(gap_ms: int) -> None:
    """It was judged by turns where it was and where the other one was."""
    found = predictor(planned(velocity=0 * TURNING), joints(READY, 0 * TURNING, 0))
    for when_ms in range(8, 40, 8):
        found.take_joints(joints(READY + 0.3 * TURNING, 0 * TURNING, when_ms - gap_ms))
        found.take_joints(joints(READY, 0 * TURNING, when_ms))
    with pytest.raises(ArmError, match=r"the arm's joints jump by 0\.30 rad: two arms' have the same names"):
        pose_at(found, 40)
    for when_ms in range(40, 520, 8):
        found.take_joints(joints(READY, 0 * TURNING, when_ms))
    np.testing.assert_allclose(pose_at(found, 520), READY)


@pytest.mark.parametrize("behind_ms", [4, 100])
def test_two_arms_are_neither_where_the_clock_of_one_is_behind(behind_ms: int) -> None:
    """All that it said came after newer joints: it was left out, and the other arm believed to be the only one."""
    found = predictor(planned(velocity=0 * TURNING))
    for when_ms in range(0, 400, 8):
        found.take_joints(joints(READY, 0 * TURNING, when_ms))
        found.take_joints(joints(READY + 2 * TURNING, 0 * TURNING, when_ms - behind_ms))
    with pytest.raises(ArmError, match=r"the arm's joints jump by 2\.00 rad: two arms' have the same names"):
        pose_at(found, 400)


@pytest.mark.parametrize(
    ("gap_ms", "turned", "jumps"), [(0, 0.09, False), (0, 0.11, True), (10, 0.24, False), (10, 0.26, True)]
)
@pytest.mark.parametrize("joint", [0, 5])
def test_a_joint_jumps_where_it_gets_farther_than_the_fastest_and_a_little_more(
    joint: int, gap_ms: int, turned: float, jumps: bool
) -> None:
    """A tenth of a radian for lost and late messages, and 15 rad/s, either way."""
    for way in (turned, -turned):
        found = predictor(planned(), joints(READY, 0 * TURNING, 0))
        found.take_joints(joints(READY + way * np.eye(6)[joint], 0 * TURNING, gap_ms))
        assert found.torn_rad(NOW + gap_ms * MS) == (pytest.approx(turned) if jumps else None)


def test_joints_that_one_message_names_twice_are_two_arms() -> None:
    """The arm that was named first was judged, and the other one driven."""
    twice = JointSample(NOW, 2 * MODEL.joint_names, np.concatenate([READY, READY + TURNING]), np.zeros(12))
    both = np.concatenate([READY, READY + TURNING])[None]
    found = ArmPredictor(MODEL, unwanted, 0.4)
    with pytest.raises(ArmError, match=r"each of the arm's once, found shoulder_pan_joint, .* more often"):
        found.take_joints(twice)
    with pytest.raises(ArmError, match="expected each of the arm's once"):
        found.take_path(JointPath(2 * MODEL.joint_names, np.array([NOW]), both))
    gripper = ("finger_joint", "finger_joint")
    found.take_joints(JointSample(NOW, (*MODEL.joint_names, *gripper), np.append(READY, [0.0, 0.1]), np.zeros(8)))
    np.testing.assert_allclose(pose_at(found, 0), READY)


def test_an_arm_at_its_fastest_does_not_jump() -> None:
    """Nor one of which a message in four comes, or that is stamped late."""
    found = predictor(planned(velocity=0 * TURNING))
    for step in range(1, 60):
        if step % 4 == 0:
            late_ms = 8 * (step % 3 - 1)
            found.take_joints(joints(READY + 3.2 * TURNING * step * 8e-3, 3.2 * TURNING, step * 8 + late_ms))
    assert found.torn_rad(NOW + 480 * MS) is None


def test_a_path_may_name_its_joints_in_any_order() -> None:
    path = planned()
    turned = JointPath(path.names[::-1], path.stamps, path.positions[:, ::-1])
    np.testing.assert_allclose(pose_at(predictor(turned), 1000), READY + TURNING)


def test_joints_without_velocities_that_come_twice_keep_those_known_before() -> None:
    found = ArmPredictor(MODEL, unwanted, 0.4)
    for when_ms in (0, 100, 100):
        sample = joints(READY + when_ms * 1e-3 * TURNING, 0 * TURNING, when_ms)
        found.take_joints(sample, has_velocities=False)
    ahead = found.ahead(NOW + 100 * MS, NOW + 100 * MS)
    np.testing.assert_allclose(ahead.positions[-1] - ahead.positions[0], 0.2 * TURNING, atol=1e-9)


@pytest.mark.parametrize("when_ms", [-150, -500])
def test_joints_that_are_much_older_than_the_path_or_stale_say_nothing_of_it(when_ms: int) -> None:
    found = predictor(planned(), joints(READY - TURNING, 0 * TURNING, when_ms))
    np.testing.assert_allclose(pose_at(found, 100), READY + 0.1 * TURNING)


@pytest.mark.parametrize(("now_ms", "measures"), [(-401, False), (-400, True), (400, True), (401, False)])
def test_joints_measure_how_fast_the_arm_goes_for_as_long_as_they_are_fresh(now_ms: int, measures: bool) -> None:
    found = predictor(planned(), joints(READY, TURNING, 0))
    assert (found.joints(NOW + now_ms * MS) is not None) == measures


def test_a_path_alone_is_believed() -> None:
    np.testing.assert_allclose(pose_at(predictor(planned()), 1000), READY + TURNING)


def test_joints_that_have_become_old_stop_the_arm_though_they_had_ended_its_path() -> None:
    found = predictor(planned(), joints(READY, 0 * TURNING, 1000))
    pose_at(found, 1000)
    with pytest.raises(ArmError, match="joints are 500 ms old"):
        pose_at(found, 1500)


def test_joints_stamped_in_the_future_stop_the_arm() -> None:
    found = predictor(planned(lasts_ms=100), joints(READY, 0 * TURNING, 1000))
    with pytest.raises(ArmError, match="joints are 500 ms in the future"):
        pose_at(found, 500)


@pytest.mark.parametrize(("when_ms", "state"), [(-1, "has not begun"), (1001, "is over")])
def test_a_path_tells_nothing_before_it_begins_and_after_it_ends(when_ms: int, state: str) -> None:
    """An arm goes on from its end only as far ahead as obstacles are forecast."""
    with pytest.raises(ArmError, match=f"trajectory {state}, and no joints come"):
        pose_at(predictor(planned(lasts_ms=1000)), when_ms)
    stands = predictor(planned(lasts_ms=1000), joints(READY, 0 * TURNING, when_ms))
    np.testing.assert_allclose(pose_at(stands, when_ms), READY)


def test_beyond_its_path_an_arm_goes_on_as_fast_as_at_its_end_and_no_farther_than_it_can() -> None:
    wrist = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.5])
    stamp = NOW + 500 * MS
    ahead = predictor(planned(lasts_ms=500, velocity=0.5 * wrist)).ahead(stamp, stamp)
    np.testing.assert_allclose(ahead.positions[-1], READY + (0.5 + 0.2) * 0.5 * wrist, atol=1e-9)
    begun = planned(lasts_ms=500, velocity=0.1 * wrist)  # and then five times as fast
    stamps, end = np.append(begun.stamps, NOW + 700 * MS), begun.positions[-1] + 0.2 * 0.5 * wrist
    faster = JointPath(MODEL.joint_names, stamps, np.concatenate([begun.positions, end[None]]))
    ahead = predictor(faster).ahead(NOW + 700 * MS, NOW + 700 * MS)
    np.testing.assert_allclose(ahead.positions[-1], end + 0.2 * 0.5 * wrist, atol=1e-9)
    stamp = NOW + 2500 * MS
    ahead = predictor(planned(lasts_ms=2500, velocity=wrist)).ahead(stamp, stamp)
    assert MODEL.upper[5] - 0.2 < READY[5] + 2.5 * wrist[5] < ahead.positions[-1, 5] == MODEL.upper[5]


@pytest.mark.parametrize(("back_ms", "turned"), [(390, 1.0), (410, 0.2)])
def test_joints_of_before_newer_ones_are_left_out_unless_the_clock_was_put_back(back_ms: int, turned: float) -> None:
    found = predictor(planned(lasts_ms=100), joints(READY + TURNING, 0 * TURNING, 1000))
    found.take_joints(joints(READY + 0.2 * TURNING, 0 * TURNING, 1000 - back_ms))
    np.testing.assert_allclose(pose_at(found, 1000 - back_ms), READY + turned * TURNING)


def test_a_cycle_is_made_up_when_it_is_looked_for_and_only_once() -> None:
    made: list[CyclicPath] = []

    def make() -> CyclicPath:
        made.append(default_path(MODEL))
        return made[-1]

    found = ArmPredictor(MODEL, make, 0.4)
    assert made == []
    for when_ms in (0, 33):
        stamp = NOW + when_ms * MS
        np.testing.assert_array_equal(found.ahead(stamp, stamp).positions, made[0].ahead(stamp).positions)
    assert len(made) == 1


def test_an_arm_for_which_no_cycle_can_be_made_up_stands_until_it_tells_of_itself() -> None:
    """Its node did not start, though the arm published its joints."""
    tries: list[int] = []

    def fail() -> CyclicPath:
        tries.append(1)
        raise ArmError("it cannot put its tool there")

    found = ArmPredictor(MODEL, fail, 0.4)
    for _ in range(3):
        with pytest.raises(ArmError, match="nobody tells of an arm, and none can be made up: it cannot put its tool"):
            found.ahead(NOW, NOW)
    assert len(tries) == 1
    found.take_joints(joints(READY, 0 * TURNING, 0))
    np.testing.assert_allclose(pose_at(found, 0), READY)


@pytest.mark.parametrize(
    ("first", "second", "has_velocities", "told"),
    [
        (0.0, 0.0, True, 1.0),
        (0.7, 0.0, True, 0.0),
        (0.7, 0.0, False, 1.0),
        (0.0, 0.7, False, 1.0),
        (0.0, 0.7, True, 0.7),
    ],
    ids=["only zeros", "measured to stand", "no more of them", "none", "the first of them"],
)
def test_velocities_are_those_of_the_way_where_none_are_measured_or_all_that_came_were_zeros(
    first: float, second: float, has_velocities: bool, told: float
) -> None:
    """It has gone 0.1 rad in 0.1 s."""
    found = ArmPredictor(MODEL, unwanted, 0.4)
    found.take_joints(joints(READY, first * TURNING, 0))
    found.take_joints(joints(READY + 0.1 * TURNING, second * TURNING, 100), has_velocities)
    measured = found.joints(NOW + 100 * MS)
    assert measured is not None
    np.testing.assert_allclose(measured.velocities, told * TURNING, atol=1e-9)


OTHERS = JointSample(NOW, tuple(f"other_{name}" for name in MODEL.joint_names), READY, 0 * TURNING)


def test_of_an_arm_that_calls_its_joints_otherwise_it_is_known_that_it_is_there_and_not_where() -> None:
    found = ArmPredictor(MODEL, unwanted, 0.4)
    assert found.is_made_up and found.refused is None
    found.take_joints(OTHERS)
    assert not found.is_made_up
    assert found.refused is not None and MODEL.joint_names[0] in found.refused
    with pytest.raises(RobotError, match=MODEL.joint_names[0]):
        found.ahead(NOW, NOW)


def test_what_a_gripper_says_on_the_same_topic_takes_nothing_from_what_is_known_of_the_arm() -> None:
    found = predictor(planned(), joints(READY, TURNING, 0))
    found.take_joints(OTHERS)
    assert found.refused is None
    measured = found.joints(NOW)
    assert measured is not None and measured.names == MODEL.joint_names


def test_an_arm_of_which_only_what_cannot_be_believed_was_told_stands_until_it_tells_better() -> None:
    found = ArmPredictor(MODEL, unwanted, 0.4)
    found.refuse("its angles are no numbers")
    assert not found.is_made_up
    found.take_joints(OTHERS)
    assert found.refused == "its angles are no numbers"
    with pytest.raises(ArmError, match="its angles are no numbers"):
        found.ahead(NOW, NOW)
    found.take_joints(joints(READY, TURNING, 0))
    assert found.refused is None
    np.testing.assert_allclose(pose_at(found, 0), READY)
    pathed = ArmPredictor(MODEL, unwanted, 0.4)
    pathed.refuse("its angles are no numbers")
    pathed.take_path(planned())
    assert pathed.refused is None and not pathed.is_made_up


def test_an_arm_that_is_to_stay_where_it_is_is_judged_by_its_joints_alone() -> None:
    nowhere = ArmPredictor(MODEL, unwanted, 0.4)
    nowhere.leave_path()
    with pytest.raises(ArmError, match="to stay where it is, and nobody has told where"):
        nowhere.ahead(NOW, NOW)
    found = predictor(planned())
    found.leave_path()
    assert found.refused is None
    with pytest.raises(ArmError, match="trajectory is over, and no joints come"):
        found.ahead(NOW, NOW)
    found.take_joints(joints(READY + TURNING, 0 * TURNING, 0))
    np.testing.assert_allclose(pose_at(found, 200), READY + TURNING)
    found.take_path(planned(begins_ms=100))
    found.take_joints(joints(READY, TURNING, 100))
    np.testing.assert_allclose(pose_at(found, 300), READY + 0.2 * TURNING)


@pytest.mark.parametrize("share", [-0.1, 1.1, 80.0, np.nan])
def test_a_share_that_is_none_is_refused(share: float) -> None:
    """By a percentage the program would be a hundred times as slow as it is: an arm that closes in on nobody."""
    found = ArmPredictor(MODEL, unwanted, 0.4)
    found.take_joints(joints(READY, TURNING, 0))
    with pytest.raises(ArmError, match="share: expected 0 to 1, as the arm was told, found"):
        found.take_joints(joints(READY + 0.01 * TURNING, TURNING, 10), share=share)
    ahead = found.ahead(NOW + 10 * MS, NOW + 10 * MS)
    np.testing.assert_allclose(ahead.positions[-1] - ahead.positions[0], 0.2 * TURNING, atol=1e-12)
