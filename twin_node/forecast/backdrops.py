"""How deep each pixel of a depth camera sees when nothing that moves is in the way."""

from __future__ import annotations

import numpy as np

from twin_node.scene import Bool, Float32, TwinState, View

UNSEEN = np.float32(1e6)
"""Depth of pixels that have shown nothing but moving things so far, m."""
LEARNING_RATE = np.float32(0.1)
"""Share of each new depth that enters a pixel's: averages about ten images of noise."""
STEP_SHARE = 0.03
"""A pixel looks past what it showed before where its depth grows by this share, plus `STEP`: 3 sigma of stereo."""
STEP = 0.02
"""m."""


class Backdrops:
    """The standing scene's depth per camera, learnt where nothing moves and where something has moved away."""

    def __init__(self) -> None:
        self._depths: dict[str, Float32] = {}

    def update(self, state: TwinState) -> None:
        """Takes in the depth images of a state; what the moving and robot masks hide stays as it was known."""
        for view, moving, robot in zip(state.frames.views, state.moving_masks, state.robot_masks, strict=True):
            if view.depth is None:
                continue
            known = view.depth > 0 if robot is None else (view.depth > 0) & ~robot
            self._depths[view.camera.name] = _revised(self.of(view), view.depth, known, moving)

    def of(self, view: View) -> Float32:
        """[H, W] depth of what stands behind each pixel, m; `UNSEEN` where nothing that stands has been seen."""
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
