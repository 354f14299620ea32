"""One set of images beside what the STATIC Gaussians alone would show: the evidence that every step works from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from twin_node.model.backgrounds import Background, grow
from twin_node.scene import Bool, Camera, Float32, Float64, FrameSet, View

MISFIT_GROWTH = 0.02
"""Noise (0 to 1) that the smallest misfit seen at a pixel is granted: five grey levels."""


MEDIAN_STRIDE = 4
"""Every how many pixels, each way, the depth is looked at for its median."""


@dataclass(frozen=True)
class Observed:
    """One view and what is known about its pixels."""

    view: View
    rgb: Float32
    """[H, W, 3] the image, 0 to 1."""
    offset_s: float
    """The view's stamp less the set's, s; never positive."""
    background: Background
    moving: Bool
    """[H, W] something moves or has moved."""
    near_moving: Bool
    """[H, W] `moving`, grown by what calibration and image noise can be wrong by."""
    usable: Bool
    """[H, W] pixels that count: valid and off the robot."""
    surprise: Float32
    """[H, W] largest channel of |image - background|, 0 to 1, less what the background's fit to the image at rest left
    over; 0 where the pixel does not count."""
    misfit: Float32
    """[H, W] what the background's fit to the image at rest left over, 0 to 1."""
    active: Bool
    """[H, W] pixels to be explained by more than the background: near what moves, or other than the background."""
    nearest: Float32 | None
    """[H, W] m: smallest depth measured in the 3 x 3 pixels around, so that edges refute nothing; 0 where unknown."""
    stale: Bool
    """[H, W] the background has been wrong here for a while although nothing moves: it has to be learnt anew."""


class Observer:
    """Puts a set's images, masks and backgrounds side by side; remembers for how long the background has been wrong."""

    def __init__(self, threshold: float, stale_s: float) -> None:
        self._threshold = threshold
        self._stale_s = stale_s
        self._wrong_s: dict[str, Float32] = {}
        self._misfit: dict[str, Float32] = {}
        self._seeding = True

    def observe(
        self,
        frames: FrameSet,
        moving: Sequence[Bool],
        robots: Sequence[Bool | None],
        backgrounds: Sequence[Background],
        dt_s: float,
    ) -> list[Observed]:
        """What is known about each view of `frames`, `dt_s` after the set before."""
        out = []
        for view, mask, robot, background in zip(frames.views, moving, robots, backgrounds, strict=True):
            usable = np.ones(mask.shape, bool) if view.valid is None else view.valid
            usable = usable if robot is None else usable & ~robot
            rgb = np.divide(view.rgb, np.float32(255), dtype=np.float32)
            surprise = self._surprise(view.camera.name, rgb, background, usable)
            grown = grow(mask, margin_px(view.camera, background.depth))
            wrong = surprise > self._threshold
            stale = self._stale(view.camera.name, wrong & ~grown, dt_s)
            offset_s = (view.stamp - frames.stamp) * 1e-9
            active = (grown | wrong) & usable
            out.append(
                Observed(
                    view,
                    rgb,
                    offset_s,
                    background,
                    mask,
                    grown,
                    usable,
                    surprise,
                    self._misfit[view.camera.name],
                    active,
                    _nearest(view.depth),
                    stale,
                )
            )
        self._seeding = False
        return out

    def _surprise(self, name: str, rgb: Float32, background: Background, usable: Bool) -> Float32:
        """[H, W] what the image differs by beyond what the background's own fit to the first images left over.

        Nothing is left over where no fit was: there is no background yet behind the arm, or where no pixel was valid.
        """
        difference = largest_channel(rgb, background.rgb)
        known = self._misfit.get(name)
        if known is None or known.shape != difference.shape:
            known = difference * usable if self._seeding else np.zeros_like(difference)
        misfit = self._misfit[name] = np.minimum(known, difference + np.float32(MISFIT_GROWTH))
        surprise: Float32 = np.maximum(difference - misfit, np.float32(0)) * usable
        return surprise

    def _stale(self, name: str, wrong: Bool, dt_s: float) -> Bool:
        before = self._wrong_s.get(name)
        if before is None or before.shape != wrong.shape:
            before = np.zeros(wrong.shape, np.float32)
        now = self._wrong_s[name] = np.where(wrong, before + np.float32(dt_s), np.float32(0))
        return now > self._stale_s


def margin_px(camera: Camera, depth: Float64) -> int:
    """Pixels that a silhouette may be off by: two of noise, and the calibration's error at the median depth."""
    return 2 + round(float(camera.sigma_m * camera.K[0, 0] / np.median(depth[::MEDIAN_STRIDE, ::MEDIAN_STRIDE])))


def _nearest(depth: Float32 | None) -> Float32 | None:
    if depth is None:
        return None
    around = cv2.erode(np.where(depth > 0, depth, np.float32(np.inf)), np.ones((3, 3), np.uint8))
    return np.where(np.isfinite(around), around, np.float32(0)).astype(np.float32)


def largest_channel(a: Float32, b: Float32) -> Float32:
    """[H, W] the largest difference of a channel between images [H, W, 3]."""
    difference = np.abs(a - b)
    largest: Float32 = np.maximum(np.maximum(difference[..., 0], difference[..., 1]), difference[..., 2])
    return largest
