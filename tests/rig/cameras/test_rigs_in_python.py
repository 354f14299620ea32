"""A rig that a script has put together is held to what a rig file is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from twin_node.rig import RigError
from twin_node.rig.cameras import CameraImage, SynchronizedSource
from twin_node.scene import Rig, RigCamera


class Nothing:
    """Cameras that send nothing."""

    cameras, health = ("left", "right"), ()

    def images(self) -> Iterator[CameraImage]:
        return iter(())

    def close(self) -> None:
        pass


def looking_down(x: float, towards: float) -> np.ndarray:
    """Pose [4, 4] of a camera 1.5 m above the base, aslant along x."""
    s, c = np.sin(towards), np.cos(towards)
    return np.array([[c, 0, s, x], [0, -1, 0, 0], [s, 0, -c, 1.5], [0, 0, 0, 1]])


K = np.array([[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1]])
LEFT = RigCamera("left", 64, 48, K, looking_down(-0.5, 0.4), D=np.array([0.1, -0.05, 0, 0, 0]))
RIGHT = RigCamera("right", 64, 48, K, looking_down(0.5, -0.4))
OPENCVS = LEFT.D.reshape(1, 5)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"D": OPENCVS}, r"camera left: D: expected finite numbers \[n\], found shape \[1, 5\]; .*`ravel\(\)`"),
        ({"D": np.full(5, np.nan)}, r"camera left: D: expected finite numbers \[n\], found \[nan, "),
        ({"D": np.full(14, 0.01)}, "left.distortion.coefficients: expected 4 or 5 numbers for plumb_bob, found 14"),
        (
            {"distortion_model": "equidistant", "D": np.zeros(5)},
            "left.distortion.coefficients: expected 4 numbers for equidistant, found 5",
        ),
        ({"distortion_model": "fisheye"}, "left.distortion.model: expected one of plumb_bob, .*, found 'fisheye'"),
        ({"K": K[:2]}, r"camera left: K: expected finite numbers \[3, 3\], found shape \[2, 3\]"),
        ({"K": K.T}, r"camera left.K: expected \[\[fx, 0, cx\], .*transpose it"),
        ({"T_base_cam": LEFT.T_base_cam * [1, 1, 1, 1000]}, "camera left.T_base_cam: expected the last row"),
        ({"T_base_cam": LEFT.T_base_cam * [[-1], [1], [1], [1]]}, "camera left.T_base_cam: .* one axis is mirrored"),
        ({"T_base_cam": LEFT.T_base_cam[:3]}, r"camera left: T_base_cam: expected finite numbers \[4, 4\]"),
    ],
)
def test_a_camera_that_no_rig_file_may_hold_is_refused(wrong: dict[str, Any], said: str) -> None:
    """Mirrored axes and another lens's coefficients put all that was seen elsewhere, in silence."""
    with pytest.raises(RigError, match=said):
        SynchronizedSource(Nothing(), Rig((replace(LEFT, **wrong), RIGHT)))


def test_poses_of_another_convention_are_refused() -> None:
    opengl = (replace(one, T_base_cam=one.T_base_cam * [1, -1, -1, 1]) for one in (LEFT, RIGHT))
    with pytest.raises(
        RigError, match="rig: cameras left, right: expected optical axes that meet in front of the cameras"
    ):
        SynchronizedSource(Nothing(), Rig(tuple(opengl), workspace=np.array([[-1.0, -1, 0], [1, 1, 1]])))


def test_a_right_rig_is_taken() -> None:
    undistorted = replace(RIGHT, D=np.zeros(0))
    assert len(SynchronizedSource(Nothing(), Rig((LEFT, undistorted))).cameras) == 2
