"""Which pixels show the arm: where its grown outline is, but for what depth shows in front of it or past it."""

from __future__ import annotations

import cv2
import numpy as np

from twin_node.model.capsules import nearest_capsules
from twin_node.robot import ArmModel, Outline, robot_outline
from twin_node.scene import Bool, Camera, Float32, FrameSet

CLEAR_M, DEPTH_SHARE = 0.03, 0.01
"""What is measured so far off the grown arm is not the arm, m and as a share of the depth: errors of depth."""
AROUND = np.ones((3, 3), np.uint8)
"""A pixel and its neighbours: at edges depth cameras measure what is nowhere, and images blend two colours."""


def robot_masks(model: ArmModel | None, frames: FrameSet) -> tuple[Bool | None, ...]:
    """Per view the pixels [H, W] that show the arm, by the set's joints and measured depth; None where arm or joints
    are not known.

    Raises `RobotError` for joints that are not the model's.
    """
    if model is None or frames.joints is None:
        return (None,) * len(frames.views)
    q = model.ordered_positions(frames.joints)
    return tuple(shown_arm(robot_outline(model, q, view.camera), view.camera, view.depth) for view in frames.views)


def shown_arm(outline: Outline, camera: Camera, depth: Float32 | None) -> Bool:
    """The pixels [H, W] of an outline, unless `depth` [H, W] (m, 0 where it is not measured) shows something else."""
    return outline.mask if depth is None else outline.mask & ~_others(outline, camera, depth)


def _others(outline: Outline, camera: Camera, depth: Float32) -> Bool:
    """[H, W] those pixels of an outline that show a point well off every capsule.

    In front of the arm, nearer to the camera than the place on an axis that is nearest to it, single pixels do not
    count; past it, where the arm was only grown to, all neighbours must be past it too.
    """
    at = np.flatnonzero(outline.mask & (depth > 0))  # counted row by row: many times as fast as by row and column
    rows, columns = np.divmod(at, camera.width)
    z, K = depth.ravel()[at].astype(np.float64), camera.K
    points = np.stack([(columns + 0.5 - K[0, 2]) / K[0, 0] * z, (rows + 0.5 - K[1, 2]) / K[1, 1] * z, z])
    found = nearest_capsules(outline.ends, outline.radii, points)
    begins, lengths = outline.ends[:, 0, 2], outline.ends[:, 1, 2] - outline.ends[:, 0, 2]
    nearer = z < begins[found.capsules] + found.shares * lengths[found.capsules]
    clear = found.gaps > CLEAR_M + DEPTH_SHARE * z
    before, past = np.zeros(depth.shape, np.uint8), (~outline.mask).astype(np.uint8)
    before.ravel()[at] = clear & nearer
    past.ravel()[at] = clear & ~nearer
    opened = cv2.morphologyEx(before, cv2.MORPH_OPEN, AROUND)
    return (opened > 0) | (cv2.erode(past, AROUND) > 0)
