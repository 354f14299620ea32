"""How deep each pixel of a depth camera sees when nothing that moves is in the way."""

from __future__ import annotations

import cv2
import numpy as np

from twin_node.scene import Bool, Float32, TwinState, View

UNSEEN = np.float32(1e6)
"""Depth of pixels that have shown nothing but moving things so far, m."""
UNMEASURED = np.float32(2e6)
"""Depth kept for pixels that have shown something that stands, and no depth of it, m."""
LEARNING_RATE = np.float32(0.1)
"""Share of each new depth that enters a pixel's: averages about ten images of noise."""
STEP_SHARE = 0.03
"""A pixel looks past what it showed before where its depth grows by this share, plus `STEP`: 3 sigma of stereo."""
STEP = 0.02
"""m."""
HOLE = 2
"""An unmeasured pixel stands as deep as the deepest that is known within so many pixels: depth cameras miss single
pixels, and the edges of what stands."""


class Backdrops:
    """The standing scene's depth per camera, learnt where nothing moves and where something has moved away."""

    def __init__(self) -> None:
        self._depths: dict[str, Float32] = {}

    def update(self, state: TwinState) -> None:
        """Takes in the depth images of a state; what the moving and robot masks hide stays as it was known."""
        for view, moving, robot in zip(state.frames.views, state.moving_masks, state.robot_masks, strict=True):
            if view.depth is None:
                continue
            bare = np.ones_like(moving) if robot is None else ~robot
            revised = _revised(self._kept(view), view.depth, bare & (view.depth > 0), moving)
            holes = bare & ~moving & (view.depth == 0) & (revised == UNSEEN)
            self._depths[view.camera.name] = np.where(holes, UNMEASURED, revised)

    def of(self, view: View) -> Float32:
        """[H, W] depth of what stands behind each pixel, m; `UNSEEN` where nothing that stands has been seen."""
        kept = self._kept(view)
        measured = np.where(kept < UNSEEN, kept, np.float32(0))
        deepest = cv2.dilate(measured, np.ones((2 * HOLE + 1,) * 2, np.uint8))
        filled = np.where((kept == UNMEASURED) & (deepest > 0), deepest, kept)
        return np.minimum(filled, UNSEEN)

    def _kept(self, view: View) -> Float32:
        """[H, W] what is known of each pixel by itself."""
        known = self._depths.get(view.camera.name)
        if known is None or known.shape != view.rgb.shape[:2]:
            return np.full(view.rgb.shape[:2], UNSEEN, np.float32)
        return known


def _revised(before: Float32, depth: Float32, known: Bool, moving: Bool) -> Float32:
    """The backdrop after one more image."""
    past = depth > before * (1 + STEP_SHARE) + STEP
    near = depth > before * (1 - STEP_SHARE) - STEP
    drawn = before + np.where(known & ~moving & near, LEARNING_RATE * (depth - before), np.float32(0))
    return np.where(known & (past | ~(moving | near)), depth, drawn).astype(np.float32)
