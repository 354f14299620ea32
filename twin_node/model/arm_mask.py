"""Which pixels show the arm: where its grown outline is, but for what depth shows in front of it or past it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from twin_node.model.capsules import SHORTEST_SQUARE, nearest_capsules
from twin_node.model.kernel_requests import OutlineRequest, OutlineView
from twin_node.model.kernels import kernels
from twin_node.native_library import addresses_of, array_of, thread_count
from twin_node.robot import ArmModel, Outline, robot_outline
from twin_node.scene import Bool, Float32, Float64, FrameSet, UInt8, View

CLEAR_M, DEPTH_SHARE = 0.03, 0.01
"""What is measured so far off the grown arm is not the arm, m and as a share of the depth: errors of depth."""
AROUND = np.ones((3, 3), np.uint8)
"""A pixel and its neighbours: at edges depth cameras measure what is nowhere, and images blend two colours."""


def robot_masks(model: ArmModel | None, frames: FrameSet) -> tuple[Bool | None, ...]:
    """Per view the pixels [H, W] that show the arm, by the joints at its stamp and measured depth; None where arm or
    joints are not known.

    Raises `RobotError` for joints that are not the model's.
    """
    if model is None or frames.joints is None:
        return (None,) * len(frames.views)
    at = [model.ordered_positions(frames.joints.at(view.stamp)) for view in frames.views]
    outlines = [robot_outline(model, q, view.camera) for q, view in zip(at, frames.views, strict=True)]
    return tuple(shown_arms(outlines, frames.views))


def shown_arms(outlines: Sequence[Outline], views: Sequence[View]) -> list[Bool]:
    """The pixels [H, W] of each view's outline, unless its depth shows something else.

    In front of the arm, nearer to the camera than the place on an axis that is nearest to it, single pixels do not
    count; past it, where the arm was only grown to, all neighbours must be past it too.
    """
    masks = [outline.mask for outline in outlines]
    measured = [index for index, view in enumerate(views) if view.depth is not None and masks[index].any()]
    cuts = [cut_out(outlines[index], views[index]) for index in measured]
    for index, cut, off in zip(measured, cuts, off_arm(cuts), strict=True):
        opened, inner = cv2.morphologyEx(off.before, cv2.MORPH_OPEN, AROUND), cv2.erode(off.past, AROUND)
        masks[index] = masks[index].copy()
        masks[index][cut.box] &= ~(opened.astype(bool) | inner.astype(bool))
    return masks


class Cut(NamedTuple):
    """The part of a view, [h, w], that holds an arm's outline and the pixels around it."""

    box: tuple[slice, slice]
    """Its rows and columns."""
    mask: Bool
    """[h, w] the outline."""
    depth: Float32
    """[h, w] m; 0 where it is not measured."""
    K: Float64
    """[3, 3] intrinsics of these pixels."""
    ends: Float64
    """[C, 2, 3] m of the axes of the arm's capsules, in the optical frame."""
    radii: Float64
    """[C] m."""


def cut_out(outline: Outline, view: View) -> Cut:
    """The smallest such part of a view that measures depth; the outline is not empty."""
    assert view.depth is not None
    left, top, width, height = cv2.boundingRect(outline.mask.view(np.uint8))
    left, top, right, bottom = max(left - 1, 0), max(top - 1, 0), left + width + 1, top + height + 1
    box, K = (slice(top, bottom), slice(left, right)), view.camera.K.copy()
    K[:2, 2] -= left, top
    mask, depth = np.ascontiguousarray(outline.mask[box]), np.ascontiguousarray(view.depth[box], np.float32)
    return Cut(box, mask, depth, K, outline.ends, outline.radii)


class OffArm(NamedTuple):
    """What depth shows that is well off every capsule of the arm, [h, w] 0 or 1."""

    before: UInt8
    """Within the outline, in front of the arm."""
    past: UInt8
    """Past the arm, or beyond the outline."""


def off_arm(cuts: Sequence[Cut]) -> list[OffArm]:
    """What each of these parts of views shows off the arm."""
    library = kernels()
    if library is None or not cuts:
        return [off_arm_reference(cut) for cut in cuts]
    calls = [_Call(cut) for cut in cuts]
    asked = array_of(OutlineView, [call.view for call in calls])
    rules = (SHORTEST_SQUARE, CLEAR_M, DEPTH_SHARE)
    library.run(OutlineRequest(len(cuts[0].radii), *rules, len(calls), thread_count(), asked))
    return [call.found for call in calls]


class _Call:
    """One view's request, and the arrays that it points to."""

    def __init__(self, cut: Cut) -> None:
        shape = cut.mask.shape
        self.found = OffArm(np.empty(shape, np.uint8), np.empty(shape, np.uint8))
        self._held = [
            *(np.ascontiguousarray(of, np.float64) for of in (cut.K, cut.ends, cut.radii)),
            *(cut.mask, cut.depth),
        ]
        self.view = OutlineView(shape[1], shape[0], *addresses_of(*self._held, *self.found))


def off_arm_reference(cut: Cut) -> OffArm:
    """The same of one of them in NumPy: the reference of the compiled kernel."""
    at = np.flatnonzero(cut.mask & (cut.depth > 0))  # counted row by row: many times as fast as by row and column
    rows, columns = np.divmod(at, cut.mask.shape[1])
    z, K = cut.depth.ravel()[at].astype(np.float64), cut.K
    points = np.stack([(columns + 0.5 - K[0, 2]) / K[0, 0] * z, (rows + 0.5 - K[1, 2]) / K[1, 1] * z, z])
    found = nearest_capsules(cut.ends, cut.radii, points)
    begins, lengths = cut.ends[:, 0, 2], cut.ends[:, 1, 2] - cut.ends[:, 0, 2]
    nearer = z < begins[found.capsules] + found.shares * lengths[found.capsules]
    clear = found.gaps > CLEAR_M + DEPTH_SHARE * z
    off = OffArm(np.zeros(cut.mask.shape, np.uint8), (~cut.mask).astype(np.uint8))
    off.before.ravel()[at] = clear & nearer
    off.past.ravel()[at] = clear & ~nearer
    return off
