"""Frame sets: order, stamps, joints; and the workspace that a rig implies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.geometry import looking_at, pose
from twin_node.rig import DecodedImage, FrameAssembler, RigError, load_rig, workspace_of
from twin_node.scene import Float64, JointSample, RigCamera

PROJECT = Path(__file__).resolve().parents[2]
MS = 1_000_000
K = np.array([[240.0, 0, 159.5], [0, 240, 119.5], [0, 0, 1]])


def camera(name: str, centre: tuple[float, float, float], target: tuple[float, float, float]) -> RigCamera:
    return RigCamera(name, 320, 240, K, looking_at(centre, target))


TARGET = (0.5, 0.0, 0.1)
CAMERAS = (
    camera("left", (1.2, 0.8, 0.9), TARGET),
    camera("right", (1.2, -0.8, 0.9), TARGET),
    camera("back", (-0.5, 0.1, 1.0), TARGET),
)


def image(stamp: int) -> DecodedImage:
    return DecodedImage(stamp, np.full((240, 320, 3), stamp // MS % 256, np.uint8))


def test_views_stand_in_the_rigs_order_with_their_own_stamps() -> None:
    assembler = FrameAssembler(CAMERAS, width=160)
    frames = assembler.assemble({"back": image(5 * MS), "left": image(9 * MS), "right": image(7 * MS)})
    assert [view.camera.name for view in frames.views] == ["left", "right", "back"]
    assert [view.stamp for view in frames.views] == [9 * MS, 7 * MS, 5 * MS]
    assert [int(view.rgb[0, 0, 0]) for view in frames.views] == [9, 7, 5]
    assert frames.stamp == 9 * MS
    assert frames.joints is None
    assert {view.rgb.shape for view in frames.views} == {(120, 160, 3)}
    assert assembler.cameras == tuple(view.camera for view in frames.views)


def test_images_that_are_narrower_than_asked_for_stay_as_they_are() -> None:
    """Enlarged they would show no more, and take as much time as wide ones."""
    small = replace(CAMERAS[0], width=80, height=60, K=np.array([[60.0, 0, 40], [0, 60, 30], [0, 0, 1]]))
    sizes = {
        width: [(c.width, c.height) for c in FrameAssembler((small, CAMERAS[1]), width).cameras]
        for width in (None, 160, 16384)
    }
    assert sizes == {None: [(80, 60), (320, 240)], 160: [(80, 60), (160, 120)], 16384: [(80, 60), (320, 240)]}
    with pytest.raises(RigError, match="expected a working size of at least 2x2, found 0x0"):
        FrameAssembler(CAMERAS, 0)


def test_a_silent_camera_is_missing_and_sets_are_counted() -> None:
    assembler = FrameAssembler(CAMERAS, width=160)
    sets = [assembler.assemble({name: image(0)}) for name in ("right", "left")]
    assert [frames.sequence for frames in sets] == [0, 1]
    assert [view.camera.name for view in sets[0].views] == ["right"]
    assembler.reset()
    assert assembler.assemble({"left": image(0)}).sequence == 0


def sample(stamp_ms: int, *positions: float, speed: float = 0.0, names: tuple[str, ...] = ("a", "b")) -> JointSample:
    return JointSample(stamp_ms * MS, names, np.array(positions), np.full(len(positions), speed))


def attached(assembler: FrameAssembler, *stamps_ms: int) -> list[JointSample | None]:
    return [assembler.assemble({"left": image(stamp * MS)}).joints for stamp in stamps_ms]


def test_joints_are_those_at_the_sets_time() -> None:
    """Of an arm that tells them at 10 Hz the nearest ones are 5 cm off at 1 m/s."""
    assembler = FrameAssembler(CAMERAS, width=160)
    for told in (sample(0, 0.0, 1.0, speed=4.0), sample(100, 0.5, 0.0, speed=6.0), sample(50, 0.4, 0.4, speed=8.0)):
        assembler.add_joints(told)
    at = (0, 10, 50, 75, 100)
    found = [one for one in attached(assembler, *at) if one is not None]
    assert [one.stamp // MS for one in found] == [*at]
    positions, speeds = np.array([(one.positions, one.velocities) for one in found]).swapaxes(0, 1)
    assert positions == pytest.approx(np.array([(0, 1.0), (0.08, 0.88), (0.4, 0.4), (0.45, 0.2), (0.5, 0)]))
    assert speeds[:, 0] == pytest.approx(np.array([4.0, 4.8, 8.0, 7.0, 6.0]))


def test_joints_without_others_around_them_keep_their_own_time() -> None:
    """By it who asks knows how old they are, and moves them on where they tell how fast."""
    assembler = FrameAssembler(CAMERAS, width=160)
    told = sample(100, 1.0, speed=2.0, names=("a",))
    assembler.add_joints(told)
    assert attached(assembler, 120, 80, 201, -1) == [told, told, None, None]
    assert told.at(120 * MS).positions == pytest.approx([1.04])
    assert told.at(120 * MS).stamp == 120 * MS
    still = sample(100, 1.0)
    assert still.at(120 * MS) is still


def test_joints_that_never_tell_velocities_are_as_fast_as_their_samples_say() -> None:
    """As of joint_state_publisher and many a driver: zeros, or nothing. Samples a moment apart tell nothing."""
    assembler = FrameAssembler(CAMERAS, width=160)
    for told in (sample(0, 0.0, 1.0), sample(100, 0.2, 0.9)):
        assembler.add_joints(told)
    found = [one for one in attached(assembler, 50, 100, 130) if one is not None]
    assert [one.stamp // MS for one in found] == [50, 100, 100]
    assert np.array([one.velocities for one in found]) == pytest.approx(np.array([(2.0, -1.0)] * 3))
    assert found[2].at(130 * MS).positions == pytest.approx([0.26, 0.87])
    assembler.add_joints(JointSample(100 * MS + 1000, ("a", "b"), np.array([0.3, 0.9]), np.zeros(2)))
    assembler.add_joints(sample(300, 0.0, 0.0))
    unknown = [one for one in attached(assembler, 130, 220) if one is not None]
    assert len(unknown) == 2
    assert not np.any([one.velocities for one in unknown])
    assembler.add_joints(sample(320, 0.0, 0.0, speed=1.0))
    assembler.add_joints(sample(340, 0.3, 0.0))  # it stands, and says so
    (standing,) = attached(assembler, 350)
    assert standing is not None
    assert not standing.velocities.any()


@pytest.mark.parametrize(
    "after",
    [sample(20, -3.1, 0.0), sample(20, 3.0, 0.0, names=("b", "a")), sample(20, 3.0, names=("a",))],
    ids=["counted within one turn", "in another order", "of others"],
)
def test_nothing_lies_between_joints_that_do_not_follow_each_other(after: JointSample) -> None:
    assembler = FrameAssembler(CAMERAS, width=160)
    before = sample(0, 3.1, 0.0)
    assembler.add_joints(before)
    assembler.add_joints(after)
    assert attached(assembler, 9, 11) == [before, after]


def test_joints_of_long_ago_are_forgotten() -> None:
    assembler = FrameAssembler(CAMERAS, width=160)
    for stamp in (0, 10, 30, 20, 3_000):
        assembler.add_joints(sample(stamp, 0.0, 0.0))
    # The first are more than two seconds older than the newest.
    stamps = [None if one is None else one.stamp // MS for one in attached(assembler, 1, 19, 26, 3_010, 3_101)]
    assert stamps == [None, None, None, 3_000, None]
    assembler.reset()
    assert attached(assembler, 3_010) == [None]


def test_joints_are_attached_again_after_their_clock_was_put_back() -> None:
    """A sample of a clock that is ahead must not outlive all that come after it."""
    assembler = FrameAssembler(CAMERAS, width=160)
    for stamp in (60_000, 10, 20):
        assembler.add_joints(sample(stamp, 0.0, 0.0))
    assert [one is not None for one in attached(assembler, 19, 60_000)] == [True, False]


def test_wrong_images() -> None:
    assembler = FrameAssembler(CAMERAS, width=160)
    with pytest.raises(RigError, match="expected images of left, right, back, found one of 'front'"):
        assembler.assemble({"front": image(0)})
    with pytest.raises(RigError, match="at least one camera, found none"):
        assembler.assemble({})
    with pytest.raises(RigError, match="at least one camera, found none"):
        FrameAssembler(())


def share_covered(box: Float64, by: Float64) -> float:
    """Share of the volume of `box` that lies inside `by`."""
    common = np.minimum(box[1], by[1]) - np.maximum(box[0], by[0])
    return float(np.prod(np.maximum(common, 0)) / np.prod(box[1] - box[0]))


@pytest.mark.parametrize("name", ["pusht_3cam", "pusht_3cam_refined", "walker_4cam"])
def test_the_derived_workspace_holds_what_a_person_would_choose(name: str) -> None:
    rig = load_rig(PROJECT / "calibration" / f"{name}.yaml").rig
    assert rig.workspace is not None
    derived = workspace_of(FrameAssembler(rig.cameras, width=160).cameras)
    assert share_covered(rig.workspace, derived) > 0.75
    assert np.prod(derived[1] - derived[0]) < 4 * np.prod(rig.workspace[1] - rig.workspace[0])


def test_the_workspace_surrounds_what_all_look_at_and_does_not_depend_on_resolution() -> None:
    cameras = FrameAssembler(CAMERAS, width=160).cameras
    box = workspace_of(cameras)
    assert (box[0] < TARGET).all()
    assert (box[1] > TARGET).all()
    assert box[0, 2] == pytest.approx(-0.05, abs=1e-9)
    np.testing.assert_allclose(box, workspace_of(FrameAssembler(CAMERAS).cameras), atol=1e-9)


def test_cameras_below_the_base_see_below_it() -> None:
    lowered = [replace(c, T_base_cam=pose(np.eye(3), np.array([0.0, 0, -2.0])) @ c.T_base_cam) for c in CAMERAS]
    assert workspace_of(FrameAssembler(lowered, width=160).cameras)[0, 2] < -2


TWIN = replace(CAMERAS[0], name="twin", T_base_cam=pose(np.eye(3), np.array([0.0, 0.1, 0])) @ CAMERAS[0].T_base_cam)
"""Beside the first camera, and looking the same way."""


@pytest.mark.parametrize("chosen", [CAMERAS[:1], (CAMERAS[0], TWIN)])
def test_parallel_views_and_one_alone_look_at_what_the_arm_stands_on(chosen: Sequence[RigCamera]) -> None:
    cameras = FrameAssembler(chosen, width=160).cameras
    eye, axis = cameras[0].T_base_cam[:3, 3], cameras[0].T_base_cam[:3, 2]
    looked_at = eye - axis * eye[2] / axis[2]
    lower, upper = workspace_of(cameras)
    assert (lower < looked_at).all() and (looked_at < upper).all()
    assert lower[2] == pytest.approx(-0.05, abs=1e-9)
    assert upper[2] < eye[2]


@pytest.mark.parametrize(
    ("chosen", "found"), [(CAMERAS[:1], "found this one alone"), ((CAMERAS[0], TWIN), "found parallel ones")]
)
@pytest.mark.parametrize("raised_m", [-3.0, 40.0])
def test_what_looks_at_nothing_near_implies_no_workspace(
    chosen: Sequence[RigCamera], found: str, raised_m: float
) -> None:
    raised = [replace(c, T_base_cam=pose(np.eye(3), np.array([0, 0, raised_m])) @ c.T_base_cam) for c in chosen]
    with pytest.raises(RigError, match=rf"{found}; give a rig file \(--rig RIG.yaml\) with `workspace"):
        workspace_of(FrameAssembler(raised, width=160).cameras)


def test_the_middle_of_what_two_parallel_cameras_look_at_is_the_middle_of_the_workspace() -> None:
    down = np.diag([1.0, -1.0, -1.0])
    pair = [replace(CAMERAS[0], name=f"cam{x}", T_base_cam=pose(down, np.array([x, 0.3, 2.0]))) for x in (0.2, 0.6)]
    lower, upper = workspace_of(FrameAssembler(pair, width=160).cameras)
    np.testing.assert_allclose((lower + upper)[:2] / 2, [0.4, 0.3], atol=0.05)
    assert 0.3 < upper[0] - lower[0] < 2.2


def test_one_that_looks_up_beside_one_that_looks_down_implies_no_workspace() -> None:
    """Their axes are parallel: where they would meet is nowhere."""
    down, up = np.diag([1.0, -1.0, -1.0]), np.eye(3)
    pair = [
        replace(CAMERAS[0], name=f"cam{i}", T_base_cam=pose(R, np.array([i, 0, 2]))) for i, R in ((0, down), (1, up))
    ]
    with pytest.raises(RigError, match="found parallel ones"):
        workspace_of(FrameAssembler(pair, width=160).cameras)


def test_cameras_that_turn_their_backs_to_each_other_see_no_volume() -> None:
    apart = [camera("left", (0.0, 1.0, 1.0), (0.4, 3.0, 1.0)), camera("right", (0.0, -1.0, 1.0), (0.4, -3.0, 1.0))]
    with pytest.raises(RigError, match="expected a volume that most of them see, found none"):
        workspace_of(FrameAssembler(apart, width=160).cameras)
