"""What is measured in metres beside a rig, depth and the arm, and what it says of the rig's unit and place."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import cv2
import numpy as np

from twin_node.geometry import inverse_pose, pose, transform
from twin_node.rig.calibrate.barcodes import MOVING_LEVELS
from twin_node.rig.calibrate.lenses import homogeneous, pixel_rays, raw_pixels
from twin_node.rig.undistort import scaled_intrinsics
from twin_node.robot import ArmModel, robot_mask
from twin_node.scene import Bool, Camera, Float64, FrameSet, Rig, RigCamera, View
from twin_node.thinning import thinned

MOST_SETS = 12
"""Sets looked at, evenly picked."""
DEPTH_PIXELS, LEAST_DEPTHS = 400, 200
"""Pixels per view whose depth is looked up in another view, and how many must be found in all for a verdict."""
DEPTH_TOLERANCE_M, DEPTH_SHARE = 0.02, 0.03
"""Depths agree within this and a share of their own: three sigma of stereo at arm's length."""
SIZE_TOLERANCE_M, SIZE_SHARE = 0.01, 0.01
"""The same where the best of many sizes is sought: noise costs all of them alike."""
SIZES = np.linspace(0.8, 1.2, 41)
"""What distances between cameras are multiplied by."""


@dataclass(frozen=True)
class Size:
    """How large a rig is by the depth that its cameras measure."""

    factor: float
    """What distances between the cameras would have to be multiplied by for their depths to agree best."""
    gain: float
    """How many times as many depths agree then."""


def size_by_depth(rig: Rig, sets: Sequence[FrameSet]) -> Size | None:
    """The size at which most of what one camera measures is measured by another at the same place.

    `sets` of raw images of any size. None where too few are measured by two cameras to tell.
    """
    poses = np.stack([camera.T_base_cam for camera in rig.cameras])
    middle, shares = poses[:, :3, 3].mean(axis=0), []
    for factor in SIZES:
        places = middle + factor * (poses[:, :3, 3] - middle)
        cameras = [
            replace(c, T_base_cam=pose(c.T_base_cam[:3, :3], t)) for c, t in zip(rig.cameras, places, strict=True)
        ]
        sized = replace(rig, cameras=tuple(cameras))
        shares.append(depth_agreement(sized, sets, SIZE_TOLERANCE_M, SIZE_SHARE) or 0.0)
    now, best = shares[int(np.abs(SIZES - 1).argmin())], int(np.argmax(shares))
    return Size(float(SIZES[best]), shares[best] / now) if now > 0 else None


def depth_agreement(
    rig: Rig, sets: Sequence[FrameSet], tolerance_m: float = DEPTH_TOLERANCE_M, share: float = DEPTH_SHARE
) -> float | None:
    """Share of the points that one camera measures which another measures at the same place, 0 to 1.

    The same is what lies within `tolerance_m` and a share of the depth. `sets` of raw images of any size. None where
    too few are measured by two cameras to tell.
    """
    agreed = judged = 0
    cameras = {camera.name: camera for camera in rig.cameras}
    for frames in thinned(sets, MOST_SETS):
        for a, b in permutations([view for view in frames.views if view.depth is not None], 2):
            apart = _apart(cameras[a.camera.name], a, cameras[b.camera.name], b)
            agreed += int((apart.gaps_m < tolerance_m + share * apart.measured_m).sum())
            judged += len(apart.gaps_m)
    return agreed / judged if judged >= LEAST_DEPTHS else None


@dataclass(frozen=True)
class _Apart:
    """Points of one camera beside what another measures where they fall."""

    gaps_m: Float64
    """[n] along the other's axis."""
    measured_m: Float64
    """[n] depth there."""


def _apart(camera_a: RigCamera, a: View, camera_b: RigCamera, b: View) -> _Apart:
    """The points that a measures and that fall on measured pixels of b."""
    assert a.depth is not None
    assert b.depth is not None
    rows, columns = np.nonzero(a.depth > 0)
    chosen = np.linspace(0, len(rows) - 1, min(DEPTH_PIXELS, len(rows))).round().astype(int)
    rows, columns = rows[chosen], columns[chosen]
    lens_a, lens_b = (camera.depth_lens or camera for camera in (camera_a, camera_b))
    pixels = (np.column_stack([columns, rows]) + 0.5) * (lens_a.width / a.depth.shape[1]) - 0.5
    rays = homogeneous(pixel_rays(lens_a, pixels))
    points = transform(inverse_pose(camera_b.T_base_cam) @ camera_a.T_base_cam, rays * a.depth[rows, columns, None])
    there = (raw_pixels(lens_b, points) + 0.5) * (b.depth.shape[1] / lens_b.width)
    inside = (points[:, 2] > 0) & (there >= 0).all(1) & (there < b.depth.shape[::-1]).all(1)
    columns, rows = there[inside].astype(np.int64).T
    measured = b.depth[rows, columns]
    known = measured > 0
    return _Apart(np.abs(points[inside, 2] - measured)[known], measured[known].astype(np.float64))


class ArmInSight:
    """When and where the images change, and where the arm was then: they fit under a rig that is right in the base."""

    def __init__(self, arm: ArmModel, rig: Rig, sets: Iterable[FrameSet]) -> None:
        """`sets` of raw images of any size."""
        self._arm = arm
        self._sets = thinned([frames for frames in sets if frames.joints is not None], MOST_SETS)
        views = [view for frames in self._sets for view in frames.views]
        by_camera = {c.name: [view.rgb for view in views if view.camera.name == c.name] for c in rig.cameras}
        self._still = {name: np.median(own, axis=0) for name, own in by_camera.items() if own}

    def agreement(self, rig: Rig) -> float | None:
        """How much more the images change where the arm is than where it was at other times, -1 to 1; None: unknown.

        The difference between the changed shares inside the arm's outline, at its own time and at others.
        """
        cameras = {camera.name: camera for camera in rig.cameras}
        gains = []
        for name, still in self._still.items():
            own = [(frames, view) for frames in self._sets for view in frames.views if view.camera.name == name]
            changed = [np.abs(view.rgb.astype(np.int16) - still).max(-1) > MOVING_LEVELS for _, view in own]
            camera = _pinhole(cameras[name], still.shape[1], still.shape[0])
            masks = [self._mask(frames, view.stamp, camera) for frames, view in own]
            gains += _gains(masks, changed)
        return float(np.mean(gains)) if len(gains) >= LEAST_GAINS else None

    def _mask(self, frames: FrameSet, stamp: int, camera: Camera) -> Bool:
        assert frames.joints is not None
        return robot_mask(self._arm, self._arm.ordered_positions(frames.joints.at(stamp)), camera, 0.0)


LEAST_GAINS = 8
"""Images in which the arm moves that are needed for a verdict."""


def _gains(masks: Sequence[Bool], changed: Sequence[Bool]) -> list[float]:
    """Per image: changed share in what the arm newly covers, less the same of the image half a recording later."""
    gains = []
    for i, mask in enumerate(masks):
        other = (i + len(masks) // 2) % len(masks)
        new = mask & ~masks[other]
        new = cv2.erode(new.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        if new.sum() >= 20:
            gains.append(float(changed[i][new].mean() - changed[other][new].mean()))
    return gains


def _pinhole(camera: RigCamera, width: int, height: int) -> Camera:
    """The camera of reduced images, its lens's distortion left out: outlines are compared to some pixels."""
    return Camera(camera.name, width, height, scaled_intrinsics(camera, width, height), camera.T_base_cam)
