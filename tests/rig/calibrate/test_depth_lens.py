"""Depth that a driver aligns with the image without its distortion, read raw to refine a rig and to check one."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from twin_node.geometry import looking_at
from twin_node.rig import Undistorter
from twin_node.rig.calibrate.lenses import homogeneous, pixel_rays
from twin_node.rig.calibrate.scales import depth_agreement
from twin_node.rig.calibrate.stills import stills_of
from twin_node.rig.undistort import without_distortion
from twin_node.scene import Float32, FrameSet, Rig, RigCamera

K = np.array([[90.0, 0, 79.5], [0, 90.0, 59.5], [0, 0, 1]])
FLOOR_M, WALL_M = 0.0, 1.2
"""Heights at which x and y lie: a floor, and a wall that is aslant to it."""


def camera_at(name: str, eye: tuple[float, float, float], target: tuple[float, float, float]) -> RigCamera:
    """A bent image of 160 x 120, and a depth image of half that size as a pinhole sees it."""
    bent = RigCamera(name, 160, 120, K, looking_at(eye, target), D=np.array([-0.3, 0.1, 0.0, 0.0, 0.0]))
    half = K / 2
    half[:2, 2], half[2, 2] = (K[:2, 2] + 0.5) / 2 - 0.5, 1
    return replace(bent, depth_lens=RigCamera(name, 80, 60, half, np.eye(4)))


def room_depth(camera: RigCamera, lens: RigCamera, pixels: np.ndarray) -> Float32:
    """[N] m how far the floor z = 0 or the wall y = WALL_M is at pixels [N, 2] of a lens in a camera's place."""
    ways = homogeneous(pixel_rays(lens, pixels)) @ camera.T_base_cam[:3, :3].T
    eye = camera.T_base_cam[:3, 3]
    with np.errstate(divide="ignore"):
        to_floor, to_wall = -eye[2] / ways[:, 2], (WALL_M - eye[1]) / ways[:, 1]
    far = np.minimum(np.where(to_floor > 0, to_floor, np.inf), np.where(to_wall > 0, to_wall, np.inf))
    return np.where(np.isfinite(far), far, 0).astype(np.float32)


def grid(width: int, height: int) -> np.ndarray:
    """[N, 2] pixels of an image, row by row."""
    v, u = np.mgrid[:height, :width].astype(np.float64)
    return np.stack([u.ravel(), v.ravel()], axis=1)


def recorded(rig: Rig, count: int) -> list[FrameSet]:
    """Sets of raw images with depth, as logs of the rig give them where it is read as if lenses bent nothing."""
    views = []
    for camera, straight in zip(rig.cameras, without_distortion(rig).cameras, strict=True):
        lens = camera.depth_lens
        assert lens is not None
        depth = room_depth(camera, lens, grid(lens.width, lens.height)).reshape(lens.height, lens.width)
        views.append(Undistorter(straight).view(0, np.zeros((120, 160, 3), np.uint8), depth))
    return [FrameSet(0, tuple(views))] * count


RIG = Rig(
    (
        camera_at("left", (-0.8, -0.6, 0.9), (0.1, 0.6, 0.2)),
        camera_at("right", (0.8, -0.6, 0.9), (-0.1, 0.6, 0.2)),
        camera_at("across", (0.0, 1.1, 1.0), (0.0, 0.0, 0.0)),
    )
)


def test_what_stands_still_has_its_depth_where_the_bent_image_shows_it() -> None:
    """It was off by the distortion: a right rig was refused as one whose surfaces do not fit."""
    for still in stills_of(RIG, recorded(RIG, 3)):
        assert still.depth is not None
        wanted = room_depth(still.camera, still.camera, grid(160, 120)).reshape(120, 160)
        known = (still.depth > 0) & (wanted > 0)
        off = np.abs(still.depth - wanted)[known]
        assert np.median(off) < 0.01
        assert known[20:-20, 20:-20].mean() > 0.8


def test_what_lies_behind_a_bent_lens_is_no_matter() -> None:
    """NumPy warned, with a line of its own, of pixels that no whole number holds."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert depth_agreement(RIG, recorded(RIG, 1)) is not None


def test_a_right_rig_agrees_with_depth_that_another_lens_saw() -> None:
    right, sets = depth_agreement(RIG, recorded(RIG, 1), 0.02, 0.01), recorded(RIG, 1)
    bare = Rig(tuple(replace(camera, depth_lens=None) for camera in RIG.cameras))
    as_bent = depth_agreement(bare, sets, 0.02, 0.01)
    assert right is not None and as_bent is not None
    assert right > 0.9
    assert as_bent < 0.8
