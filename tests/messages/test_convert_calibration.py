"""Cameras and transforms through messages and back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from both_ways import STAMP, assert_same, sent
from hypothesis import given
from hypothesis import strategies as st

from twin_node.geometry import inverse_pose, pose, rotation_from_quat
from twin_node.messages import MessageError
from twin_node.messages import convert as c
from twin_node.scene import Rig, RigCamera


def camera(name: str = "front", seed: int = 0) -> RigCamera:
    rng = np.random.default_rng(seed)
    K = np.array([[600.0, 0, 321.5], [0, 610.0, 239.25], [0, 0, 1]])
    T = pose(rotation_from_quat(rng.normal(size=4)), rng.normal(size=3))
    return RigCamera(name, 640, 480, K, T, "plumb_bob", np.array([0.1, -0.2, 0.001, 0.002, 0.05]), sigma_m=0.004)


def test_cameras_survive() -> None:
    info = sent(c.camera_info(camera(), STAMP))
    assert info.header.frame_id == "front_optical_frame"
    np.testing.assert_array_equal(info.p.reshape(3, 4)[:, :3], camera().K)
    assert_same(c.rig_camera(info, "front", camera().T_base_cam, 0.004), camera())
    fisheye = replace(camera(), distortion_model="equidistant", D=np.array([0.1, -0.2, 0.01, 0.02]))
    assert_same(c.rig_camera(sent(c.camera_info(fisheye, STAMP)), "front", fisheye.T_base_cam, 0.004), fisheye)


@pytest.mark.parametrize("model", ["", "plumb_bob", "rational_polynomial", "equidistant"])
def test_a_camera_whose_images_are_straight_may_say_nothing_of_distortion(model: str) -> None:
    """As simulators and drivers of rectified cameras do."""
    info = replace(c.camera_info(camera(), STAMP), distortion_model=model, d=np.zeros(0))
    found = c.rig_camera(sent(info), "front", np.eye(4))
    assert (found.distortion_model, found.D.tolist()) == ("plumb_bob", [0.0] * 5)


def test_binning_and_region_of_interest_keep_every_ray() -> None:
    info = c.camera_info(camera(), STAMP)
    info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = 100, 50, 400, 300
    info.binning_x, info.binning_y = 2, 3
    fitted = c.rig_camera(info, "front", camera().T_base_cam)
    assert (fitted.width, fitted.height) == (200, 100)
    full = camera().K @ [0.1, -0.05, 1.0]
    binned = fitted.K @ [0.1, -0.05, 1.0]
    # pixel i of the binned region covers full pixels 100 + 2 i and 100 + 2 i + 1, its centre lies between theirs
    np.testing.assert_allclose(binned[:2] * [2, 3] + [0.5, 1] + [100, 50], full[:2])


def test_rectified_images_were_seen_by_p_without_distortion() -> None:
    """Undistorting them once more bends them by as much as the lens did."""
    info = c.camera_info(camera(), STAMP)
    info.p[:] = [500, 0, 310, 0, 0, 505, 230, 0, 0, 0, 1, 0]
    found = c.rig_camera(sent(info), "front", np.eye(4), is_rectified=True)
    np.testing.assert_array_equal(found.K, [[500, 0, 310], [0, 505, 230], [0, 0, 1]])
    assert not found.D.any()
    info.p[:] = 0
    with pytest.raises(MessageError, match="camera front: its images are rectified, and its CameraInfo has no P"):
        c.rig_camera(info, "front", np.eye(4), is_rectified=True)
    straight = c.rig_camera(replace(info, d=np.zeros(5)), "front", np.eye(4), is_rectified=True)
    np.testing.assert_array_equal(straight.K, camera().K)


@pytest.mark.parametrize("is_rectified", [True, False])
@pytest.mark.parametrize("move", [[-0.12, 0.004, -0.003], [0.004, -0.12, -0.003]])
def test_a_stereo_pair_is_where_its_calibration_has_it(move: list[float], is_rectified: bool) -> None:
    """Both name one frame, that of the first one's rectified images; OpenCV says how these lie to the raw ones."""
    K = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
    turn = rotation_from_quat(np.array([1.0, 0.02, -0.03, 0.01]))
    R1, R2, P1, P2, *_ = cv2.stereoRectify(K, np.zeros(5), K, np.zeros(5), (320, 240), turn, np.array(move))
    T_base_frame = camera().T_base_cam
    infos = []
    for R, P in ((R1, P1), (R2, P2)):
        info = c.camera_info(RigCamera("one", 320, 240, K, np.eye(4)), STAMP)
        info.r[:], info.p[:] = R.ravel(), P.ravel()
        infos.append(info)
    found = [
        c.rig_camera(info, "one", c.of_pair(info, infos, T_base_frame), is_rectified=is_rectified) for info in infos
    ]
    point = np.array([0.3, -0.2, 1.5])  # in the first one's raw images
    seen = [R1 @ point, R2 @ (turn @ point + move)] if is_rectified else [point, turn @ point + move]
    for one, expected in zip(found, seen, strict=True):
        in_base = T_base_frame[:3, :3] @ R1 @ point + T_base_frame[:3, 3]
        np.testing.assert_allclose(inverse_pose(one.T_base_cam)[:3] @ np.append(in_base, 1), expected, atol=1e-9)


def test_cameras_with_frames_of_their_own_are_where_these_are() -> None:
    """Though P tells how far from the first one the second is, as a RealSense's and a ZED's does."""
    left, right = (c.camera_info(camera(name), STAMP) for name in ("left", "right"))
    right.p[3] = -36.0
    np.testing.assert_array_equal(c.of_pair(right, [left, right], np.eye(4)), np.eye(4))


@pytest.mark.parametrize("R", [np.zeros(9), 2 * np.eye(3).ravel(), np.diag([1.0, 1, -1]).ravel()])
def test_what_is_no_rotation_is_none_or_refused(R: np.ndarray) -> None:
    info = c.camera_info(camera(), STAMP)
    info.r[:] = R
    if not R.any():
        np.testing.assert_array_equal(c.rig_camera(info, "front", np.eye(4)).T_base_cam, np.eye(4))
        return
    with pytest.raises(MessageError, match=r"camera front: CameraInfo has R .* which is no rotation"):
        c.rig_camera(info, "front", np.eye(4))


@pytest.mark.parametrize(
    ("roi", "binning", "words"),
    [
        ((0, 0), (641, 1), "641x1 pixels of 640x480 make one; correct its binning"),
        ((100, 80), (90, 90), "90x90 pixels of 100x80 make one; correct its binning"),
        ((70_000, 480), (1, 1), "a region of 70000x480 of 640x480 pixels; correct its roi"),
        ((640, 481), (1, 1), "a region of 640x481 of 640x480 pixels; correct its roi"),
    ],
)
def test_regions_and_binning_that_leave_no_image_are_named(
    roi: tuple[int, int], binning: tuple[int, int], words: str
) -> None:
    info = c.camera_info(camera(), STAMP)
    info.roi.width, info.roi.height = roi
    info.binning_x, info.binning_y = binning
    with pytest.raises(MessageError, match=words):
        c.rig_camera(info, "front", np.eye(4))


@pytest.mark.parametrize(("model", "count"), [("plumb_bob", 5), ("rational_polynomial", 8), ("equidistant", 4)])
def test_zeros_after_a_model_s_coefficients_are_left_out(model: str, count: int) -> None:
    """Some drivers send all fourteen that OpenCV has a name for."""
    info = c.camera_info(camera(), STAMP)
    D = np.pad(np.linspace(0.1, 0.2, count), (0, 14 - count))
    found = c.rig_camera(replace(info, distortion_model=model, d=D), "front", np.eye(4))
    np.testing.assert_array_equal(found.D, D[:count])
    D[-1] = 1e-3
    with pytest.raises(MessageError, match=f"{model} needs .*{count} finite"):
        c.rig_camera(replace(info, distortion_model=model, d=D), "front", np.eye(4))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"k": np.zeros(9)}, "no calibration"),
        ({"k": np.array([600.0, 0, 320, 0, 0, 240, 0, 0, 1])}, "no calibration"),
        ({"k": np.array([600.0, 0, np.nan, 0, 610, 240, 0, 0, 1])}, "no calibration"),
        ({"width": 0}, "images are 0x"),
        ({"height": 2**32 - 1}, "x4294967295; correct it, or give a rig file"),
        ({"distortion_model": "fisheye624"}, "distortion model 'fisheye624'"),
        ({"d": np.zeros(3)}, "plumb_bob needs 4 or 5 finite"),
        ({"d": np.full(5, np.nan)}, "plumb_bob needs 4 or 5 finite"),
    ],
)
def test_cameras_without_calibration_are_named(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(MessageError, match=words) as caught:
        c.rig_camera(replace(c.camera_info(camera(), STAMP), **changes), "front", np.eye(4))
    assert str(caught.value).startswith("camera front")


@given(st.integers(0, 1000))
def test_poses_survive_static_transforms(seed: int) -> None:
    rig = Rig((camera("left", seed), camera("right", seed + 1)))
    tree = c.TransformTree()
    tree.add(sent(c.tf_static(rig, STAMP)))
    for item in rig.cameras:
        np.testing.assert_allclose(tree.lookup(c.optical_frame(item.name)), item.T_base_cam, atol=1e-12)


def test_chains_are_composed_across_branches() -> None:
    T_world_base, T_world_link, T_link_cam = (camera(seed=seed).T_base_cam for seed in (1, 2, 3))
    messages = [
        c.transform_stamped("world", "base_link", T_world_base, 0),
        c.transform_stamped("/world", "cam_link", T_world_link, 0),
        c.transform_stamped("cam_link", "cam_optical", T_link_cam, 0),
    ]
    tree = c.TransformTree()
    for message in messages:
        tree.add(replace(c.tf_static(Rig(()), 0), transforms=[message]))
    expected = inverse_pose(T_world_base) @ T_world_link @ T_link_cam
    np.testing.assert_allclose(tree.lookup("cam_optical"), expected, atol=1e-12)
    assert "cam_optical" in tree
    assert "world" not in tree


@pytest.mark.parametrize("change", [{"w": 0.0, "x": 0.0, "y": 0.0, "z": 0.0}, {"x": np.nan}, {"z": np.inf}])
def test_transforms_that_are_none_are_refused(change: dict[str, float]) -> None:
    """A node that fills in no rotation sends zeros: a pose of NaN would place a camera nowhere, without a word."""
    stamped = c.transform_stamped("base_link", "cam", np.eye(4), 0)
    stamped.transform.rotation = replace(stamped.transform.rotation, **change)
    tree = c.TransformTree()
    other = c.transform_stamped("base_link", "other", np.eye(4), 0)
    tree.add(replace(c.tf_static(Rig(()), 0), transforms=[stamped, other]))
    with pytest.raises(MessageError, match="transform base_link to cam: expected finite numbers and a quaternion"):
        tree.lookup("cam")
    np.testing.assert_array_equal(tree.lookup("other"), np.eye(4))
    tree.add(replace(c.tf_static(Rig(()), 0), transforms=[c.transform_stamped("base_link", "cam", np.eye(4), 0)]))
    np.testing.assert_array_equal(tree.lookup("cam"), np.eye(4))


def test_a_base_that_is_called_otherwise_is_told_of_with_what_to_do() -> None:
    """A driver with a tf_prefix calls its arm's so."""
    tree, one = c.TransformTree(), np.eye(4)
    tree.add(replace(c.tf_static(Rig(()), 0), transforms=[c.transform_stamped("left_base_link", "cam", one, 0)]))
    with pytest.raises(MessageError, match="if left_base_link is the arm's, publish base_link at it, without a turn"):
        tree.lookup("cam")
    link = c.transform_stamped("left_base_link", "base_link", one, 0)
    tree.add(replace(c.tf_static(Rig(()), 0), transforms=[link]))
    np.testing.assert_array_equal(tree.lookup("cam"), one)


def test_frames_that_nothing_joins_and_loops_are_named() -> None:
    tree = c.TransformTree()
    tree.add(replace(c.tf_static(Rig(()), 0), transforms=[c.transform_stamped("a", "b", np.eye(4), 0)]))
    with pytest.raises(MessageError, match="frame b: no transforms join it to base_link"):
        tree.lookup("b")
    tree.add(replace(c.tf_static(Rig(()), 0), transforms=[c.transform_stamped("b", "a", np.eye(4), 0)]))
    with pytest.raises(MessageError, match="loop"):
        tree.lookup("b")
