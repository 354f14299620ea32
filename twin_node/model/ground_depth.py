"""How deep the ground is that one camera sees, and where depth tells it from what stands on it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from twin_node.scene import Bool, Float32, View
from twin_node.scene.depth_noise import noise_slack

LEARNING_RATE = 0.05
"""Share of each new image, and of its depth, that enters the background where it is free."""
DEPTH_LEVELS = 0.02
"""Smallest change of depth that counts, as a share of the depth (stereo and time-of-flight noise at 1 to 2 m)."""
NEAR_M = 0.01
"""Smallest change of depth that counts beside `DEPTH_LEVELS`, m."""
LOUD = 3.0
"""So many times the usual noise cannot be it."""
NOISE_SHARE = 0.05
"""Share of each new image in what is known of its camera's noise."""
MOST_FIRST_NOISE = 0.05
"""Most that the first two images count for, m at 1 m: more is no noise, something has happened in between."""
SAMPLED, LEAST_SAMPLE = 4, 50
"""Every how many pixels, each way, the noise is measured, and of how many at least."""
TELLING = 0.5
"""Share of a pixel's images of ground in which its depth must have been measured for the lack of it to tell."""
LOST_NS = 300_000_000
"""What has not been measured for so long there is dark cloth or hair, not ground: by chance single images lack it."""
SILENT_NS = 1_000_000_000
"""A camera none of whose images has had depth for so long measures none."""
SIGMA_OF_DIFFERENCE = 1.48 / 2**0.5
"""1 sigma of one of two alike, by the median of how much they differ."""
_AROUND = np.ones((3, 3), np.uint8)
_CROSS = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))


@dataclass(frozen=True)
class Told:
    """What depth tells of one image, each [H, W]."""

    in_front: Bool
    """A surface is measured in front of the ground."""
    rim: Bool
    """One is, or was when something was measured last, there or at a pixel beside: colours of both may be mixed."""
    telling: Bool
    """Ground is measured there, and so what is not measured is not ground."""
    lost: Bool
    """Of these, where nothing has been measured for long."""


class GroundDepth:
    """One camera's ground, in arrays [H, W] that the compiled mask changes likewise."""

    def __init__(self, view: View) -> None:
        shape = view.rgb.shape[:2]
        self.known = np.zeros(shape, np.float32)  # m, or 0
        if view.depth is not None:
            self.known[:] = view.depth  # row by row, whatever the order of the image's own pixels in memory
        self.measured = np.zeros(shape, np.float32)  # m, by the newest image that measured it
        self.telling = np.zeros(shape, np.float32)  # share of the images of ground that measured it
        self.blind_ns = np.zeros(shape, np.float32)  # since that image
        self.noise = 0.0  # 1 sigma at 1 m, m, growing with the square of the depth; 0 until it has been measured
        self._stamp = self._seen_at = view.stamp

    @property
    def is_told(self) -> bool:
        """Whether any depth is known: else colours alone must tell ground from somebody who stands there."""
        return bool((self.known > 0).any())

    def is_silent(self, view: View) -> bool:
        """Whether the camera has sent no depth for long; called once per image, in rising order of stamps."""
        if view.depth is not None:
            self._seen_at = view.stamp
        return view.stamp - self._seen_at > SILENT_NS

    def measure_noise(self, view: View, free: Bool) -> None:
        """Takes in how much what is `free` [H, W] differs from the depth that was measured there before."""
        if view.depth is None:
            return
        lines = (slice(None, None, SAMPLED),) * 2
        now, before = view.depth[lines], self.measured[lines]
        both = free[lines] & (now > NEAR_M) & (before > NEAR_M)
        if np.count_nonzero(both) > LEAST_SAMPLE:
            now, before = now[both], before[both]
            apart = (np.abs(now - before) / (before * before)).astype(np.float32)
            sigma = SIGMA_OF_DIFFERENCE * float(middle(apart))
            self.noise = with_noise(self.noise, sigma, 0.0, MOST_FIRST_NOISE)

    def meet(self, view: View, fresh: Bool) -> None:
        """Takes what is measured where pixels are seen for the first time."""
        if view.depth is not None:
            self.known[fresh] = view.depth[fresh]
            self.telling[fresh] = view.depth[fresh] > 0

    def look(self, view: View, elapsed_ns: int, seen: Bool, free: Bool) -> Told:
        """What a view tells, `elapsed_ns` after the one before; learns how often what is `free` is measured."""
        self.blind_ns += np.float32(elapsed_ns)
        newest = self.measured
        if view.depth is not None:
            is_measured = view.depth > 0
            self.blind_ns[is_measured] = 0
            newest = np.where(is_measured, view.depth, newest)
            self.telling += np.where(free, np.float32(LEARNING_RATE), np.float32(0)) * (is_measured - self.telling)
        telling = (self.telling >= TELLING) & (not self.is_silent(view))
        return Told(
            in_front=self.stands_before(view, seen),
            rim=cv2.dilate(self._nearer(newest, seen).astype(np.uint8), _AROUND) > 0,
            telling=telling,
            lost=telling & (self.blind_ns > LOST_NS),
        )

    def stands_before(self, view: View, seen: Bool) -> Bool:
        """Where a view measures what is before the ground, or where none was seen yet, before all that hid it."""
        return np.zeros_like(seen) if view.depth is None else self._before_ground(view.depth, seen)

    def come(self, view: View, in_front: Bool) -> Bool:
        """Where what is `in_front` was not when measured before: what only comes nearer may be the background."""
        if view.depth is None:
            return in_front
        both = (self.measured > 0) & (view.depth > 0)
        come = in_front & (~both | self._is_before(view.depth, self.measured))
        return in_front & (cv2.dilate(come.astype(np.uint8), _CROSS) > 0)

    def slack(self, depth: Float32) -> Float32:
        """Smallest change that counts, m, of depths [...] (m) that this camera measures."""
        least = np.float32(DEPTH_LEVELS) * depth + np.float32(NEAR_M)
        slack: Float32 = np.maximum(least, noise_slack(depth, self.noise))
        return slack

    def learn(self, view: View, rate: Float32, free: Bool) -> None:
        """Draws the ground towards what is measured, by a share `rate` [H, W], at most all of it where it is `free`.

        Taken whole it would go along with whatever comes at the camera, and keep every outlier. Where none is known
        the first to be measured is taken, and at once what is found behind it twice in a row: ground that was hidden.
        What lies deeper is learnt behind what moves, too.
        """
        if view.depth is None:
            return
        is_measured = view.depth > 0
        deeper = np.where(view.depth > self.known, np.maximum(rate, np.float32(LEARNING_RATE)), rate)
        share = np.where(self.known == 0, free.astype(np.float32), deeper)
        behind = np.minimum(view.depth, self.measured)
        bared = is_measured & (self.known > 0) & (behind > self.known + self.slack(self.known))
        drawn = self.known + np.where(is_measured, share * (view.depth - self.known), np.float32(0))
        self.known = np.where(bared, behind, drawn)
        self.measured = np.where(is_measured, view.depth, self.measured).astype(np.float32)

    def forget(self, where: Bool) -> None:
        """Knows nothing of the ground `where` something measured has left some that is not: a mat, a shining floor."""
        self.known[where] = 0
        self.telling[where] = 0

    def _before_ground(self, depth: Float32, seen: Bool) -> Bool:
        """[H, W] where a depth is clearly less than the ground's; single pixels are noise."""
        return cv2.morphologyEx(self._nearer(depth, seen).astype(np.uint8), cv2.MORPH_OPEN, _CROSS) > 0

    def _nearer(self, depth: Float32, seen: Bool) -> Bool:
        """[H, W] the same with single pixels."""
        return np.asarray(seen & (depth > 0) & (self.known > 0) & self._is_before(depth, self.known))

    def _is_before(self, depth: Float32, other: Float32) -> Bool:
        """Where one depth is clearly less than another, both known."""
        return np.asarray(depth < other - self.slack(other))


def with_noise(known: float, noise: float, usual: float, most: float) -> float:
    """What is known of a camera's noise, 0 until there is anything, with another image's.

    The first, if it is far more than is `usual`, counts whole, but no more than `most`: what is once held for moving is
    not measured any more.
    """
    if not known and noise > LOUD * usual:
        return min(noise, most)
    before = known or usual
    return before + NOISE_SHARE * (noise - before)


def middle(values: Float32) -> Float32:
    """The upper median [...] of values [..., n]: `np.median` takes ten times as long on so few."""
    half = values.shape[-1] // 2
    return np.partition(values, half, axis=-1)[..., half]
