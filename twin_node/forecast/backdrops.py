"""How deep each pixel of a depth camera sees when nothing that moves is in the way."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from twin_node.forecast.kernel_requests import ReviseRequest
from twin_node.forecast.kernels import kernels
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Float32, TwinState, View
from twin_node.scene.depth_noise import MOST_NOISE, NOISE_SIGMAS, noise_slack

UNSEEN = np.float32(1e6)
"""Depth of pixels that have shown nothing but moving things so far, m."""
UNMEASURED = np.float32(2e6)
"""Depth kept for pixels that have shown something that stands, and no depth of it, m."""
LEARNING_RATE = np.float32(0.1)
"""Share of each new depth that enters a pixel's: averages about ten images of noise."""
STEP_SHARE = 0.03
"""A pixel looks past what it showed before where its depth grows by this share, plus `STEP`: 3 sigma of stereo,
or by more than its camera's noise where that is known to be more."""
STEP = 0.02
"""m."""
NOISE_SHARE, NOISE = 0.01, 0.01
"""A depth that differs from its mean by no more than this share of it, plus `NOISE` (m), differs by noise, of whatever
camera; of one that is noisier by no more than its own noise."""
HOLE = 2
"""An unmeasured pixel stands as deep as the deepest that is known within so many pixels: depth cameras miss single
pixels, and the edges of what stands."""
_BESIDE = np.ones((3, 3), np.uint8)
"""A pixel, and those right beside it."""


class Backdrops:
    """The standing scene's depth per camera, learnt where nothing moves and where something has moved away."""

    def __init__(self) -> None:
        self._known: dict[str, Backdrop] = {}
        self._noise: dict[str, float] = {}
        """Of each camera's depth, as in `TwinState.depth_noise`."""

    def update(self, state: TwinState) -> None:
        """Takes in the depth images of a state; what the moving and robot masks hide stays as it was known."""
        for view, moving, robot in zip(state.frames.views, state.moving_masks, state.robot_masks, strict=True):
            if view.depth is not None:
                name = view.camera.name
                noise = self._noise[name] = state.depth_noise_of(name)
                self._known[name] = revised(self._of(view).kept, view.depth, moving, robot, noise)

    def of(self, view: View) -> Float32:
        """[H, W] depth of what stands behind each pixel, m; `UNSEEN` where nothing that stands has been seen."""
        return self._of(view).filled

    def unmeasured(self, view: View) -> Bool | None:
        """[H, W] pixels of which no depth of what stands is known, nor right beside them; None for a camera that has
        sent no depth yet."""
        known = self._found(view)
        if known is None:
            return None
        return np.asarray(cv2.dilate((known.kept < UNSEEN).astype(np.uint8), _BESIDE) == 0)

    def calmed(self, view: View) -> Float32:
        """[H, W] the depth that a view measures, m: its mean where the two differ by no more than noise does."""
        assert view.depth is not None
        mean = self._of(view).kept
        slack = np.maximum(NOISE_SHARE * mean + NOISE, noise_slack(mean, self._noise.get(view.camera.name, 0.0)))
        is_noise = np.abs(view.depth - mean) <= slack
        return np.where(is_noise, mean, view.depth)

    def _of(self, view: View) -> Backdrop:
        known = self._found(view)
        if known is None:
            nothing = np.full(view.rgb.shape[:2], UNSEEN, np.float32)
            return Backdrop(nothing, nothing)
        return known

    def _found(self, view: View) -> Backdrop | None:
        known = self._known.get(view.camera.name)
        return None if known is None or known.kept.shape != view.rgb.shape[:2] else known


@dataclass(frozen=True)
class Backdrop:
    """What is known of one camera's pixels."""

    kept: Float32
    """[H, W] m, of each by itself; `UNMEASURED` where nothing moves and no depth is known."""
    filled: Float32
    """[H, W] m, the same with such holes filled."""


def revised(before: Float32, depth: Float32, moving: Bool, robot: Bool | None, noise: float = 0.0) -> Backdrop:
    """The backdrop [H, W] after one more image, filled too; `noise` of its depth as in `TwinState.depth_noise`.

    Compiled; `revised_reference` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return revised_reference(before, depth, moving, robot, noise)
    found, (height, width) = Backdrop(np.empty_like(before), np.empty_like(before)), before.shape
    given = (np.ascontiguousarray(depth, np.float32), *(_bytes(mask) for mask in (moving, robot)), before)
    sizes, lengths = (
        (width, height, HOLE),
        (STEP_SHARE, LEARNING_RATE, STEP, UNSEEN, UNMEASURED, NOISE_SIGMAS * noise, MOST_NOISE),
    )
    compiled.run(ReviseRequest(*sizes, *lengths, *addresses_of(*given, found.kept, found.filled)))
    return found


def revised_reference(
    before: Float32, depth: Float32, moving: Bool, robot: Bool | None, noise: float = 0.0
) -> Backdrop:
    """What `revised` does."""
    bare = np.ones_like(moving) if robot is None else ~robot
    known = bare & (depth > 0)
    slack = noise_slack(before, noise)
    past = depth > np.maximum(before * (1 + STEP_SHARE) + STEP, before + slack)
    near = depth > np.minimum(before * (1 - STEP_SHARE) - STEP, before - slack)
    drawn = before + np.where(known & ~moving & near, LEARNING_RATE * (depth - before), np.float32(0))
    after = np.where(known & (past | ~(moving | near)), depth, drawn).astype(np.float32)
    holes = bare & ~moving & (depth == 0) & (after == UNSEEN)
    kept = np.where(holes, UNMEASURED, after)
    return Backdrop(kept, _filled(kept))


def _filled(kept: Float32) -> Float32:
    """A backdrop [H, W] whose unmeasured pixels are as deep as the deepest about them."""
    measured = np.where(kept < UNSEEN, kept, np.float32(0))
    deepest = cv2.dilate(measured, np.ones((2 * HOLE + 1,) * 2, np.uint8))
    whole = np.where((kept == UNMEASURED) & (deepest > 0), deepest, kept)
    return np.minimum(whole, UNSEEN)


def stands_out(depth: Float32, backdrop: Float32) -> Bool:
    """[H, W] where a depth is clearly less than what stands behind."""
    return np.asarray(depth < backdrop * np.float32(1 - STEP_SHARE) - np.float32(STEP))


def _bytes(mask: Bool | None) -> Bool | None:
    return None if mask is None else np.ascontiguousarray(mask)
