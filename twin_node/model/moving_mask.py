"""Which pixels show something that moves or has moved: causal, from the images alone."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from twin_node.scene import Bool, Float32, FrameSet, UInt8, View


@dataclass(frozen=True)
class MovingMaskParameters:
    """What counts as change, and when a pixel that changed is background again."""

    change_sigmas: float = 6.0
    """A pixel has changed when it differs by this many times the image's own noise (1 sigma, measured)."""
    change_levels: float = 9.0
    """Smallest difference that counts, in 8-bit levels: below it lie compression artefacts."""
    baseline_ns: int = 100_000_000
    """An image is compared with one this much older: slow limbs move a pixel in 100 ms, not between two frames."""
    settle_ns: int = 120_000_000
    """A pixel still for this long may be recognised as uncovered background."""
    smallest_area: float = 6e-4
    """Smallest moving region as a share of the image; less is noise."""
    gap: float = 0.03
    """Gaps inside a moving thing up to this share of the image's shorter side are closed."""
    shadow_darkest: float = 0.7
    """A cast shadow keeps at least this share of the background's brightness (and its colour)."""
    reflection_brightest: float = 1.2
    """A reflected glow adds at most up to this multiple of the background's brightness."""
    learning_rate: float = 0.05
    """Share of each new image that enters the background where it is free."""
    depth_levels: float = 0.02
    """Smallest change of depth that counts, as a share of the depth (stereo and time-of-flight noise at 1 to 2 m)."""


class MovingMask:
    """Moving masks of a rig, image set by image set.

    Looks at images up to the present only; the first image of a camera is taken as the scene at rest until something
    in it moves. What moved and stopped stays in the mask; uncovered ground leaves it once it is known to be ground.
    """

    def __init__(self, parameters: MovingMaskParameters | None = None) -> None:
        self.parameters = parameters or MovingMaskParameters()
        self._cameras: dict[str, _CameraMask] = {}

    def update(self, frames: FrameSet, robot_masks: Sequence[Bool | None]) -> tuple[Bool, ...]:
        """Masks [H, W] per view of `frames`, True where something moves or has moved; the robot is left out.

        `robot_masks`: per view [H, W] True on the arm and its margin, or None where the arm's joints are unknown.
        """
        masks = []
        for view, robot in zip(frames.views, robot_masks, strict=True):
            camera = self._cameras.get(view.camera.name)
            if camera is None or camera.shape != view.rgb.shape[:2]:
                camera = self._cameras[view.camera.name] = _CameraMask(view, self.parameters)
            masks.append(camera.update(view, robot))
        return tuple(masks)


class _CameraMask:
    """One camera's background and the mask of what stands out from it. Images are float planes [3, H, W]."""

    def __init__(self, view: View, parameters: MovingMaskParameters) -> None:
        self.parameters = parameters
        self.shape = view.rgb.shape[:2]
        self._background = _planes(view.rgb)
        self._depth = None if view.depth is None else view.depth.copy()
        self._trusted = np.ones(self.shape, np.bool_)  # False where the background may show the moving thing itself
        self._confirmed = np.zeros(self.shape, np.bool_)  # was covered once, and is known to be ground since
        self._mask = np.zeros(self.shape, np.bool_)
        self._still_ns = np.zeros(self.shape, np.float32)
        self._sigma = parameters.change_levels / parameters.change_sigmas
        self._past: deque[tuple[int, Float32]] = deque([(view.stamp, self._background.copy())])
        self._close = _disk(max(1, round(parameters.gap * min(self.shape))))

    def update(self, view: View, robot: Bool | None) -> Bool:
        """The mask [H, W] of this view."""
        image = _planes(view.rgb)
        seen = _seen(view, robot)
        free = seen & ~self._mask
        gain = _gain(image, self._background, free)
        expected = self._background * gain
        difference = _difference(image, expected)
        change = self._measure_change(image, view.stamp, free)
        threshold = max(self.parameters.change_levels, self.parameters.change_sigmas * self._sigma)
        lit = self._lighting_only(image, expected, threshold)
        stands_out = np.where(self._trusted & ~lit, difference, 0)
        moving = self._regions(np.maximum(stands_out, np.where(lit & self._trusted, 0, change)), threshold)
        in_front = self._depth_in_front(view)
        moving |= in_front
        moving = (moving | self._unconfirmed_holes(moving)) & seen
        background_again = self._trusted & (lit | (difference < 0.5 * threshold))
        mask = (moving | (self._mask & ~_eroded(background_again))) & seen
        self._trusted &= ~(mask & ~self._mask & (difference < 0.5 * threshold) & (change < threshold) & ~in_front)
        self._confirmed |= self._mask & ~mask
        self._mask = mask
        self._release_uncovered(image, gain, difference, change, threshold, ~in_front)
        self._learn(image / gain, view, seen & ~self._mask)
        return self._mask.copy()

    def _measure_change(self, image: Float32, stamp: int, free: Bool) -> Float32:
        """Difference [H, W] from the image one baseline ago; updates noise, stillness and the past."""
        reference = next(
            (past for at, past in self._past if stamp - at <= self.parameters.baseline_ns), self._past[-1][1]
        )
        change = _difference(image, reference * _gain(image, reference, free))
        sample = change[::4, ::4][free[::4, ::4]]
        if sample.size > 50:
            self._sigma += 0.05 * (max(0.5, 1.48 * float(np.median(sample))) - self._sigma)
        last_stamp, last = self._past[-1]
        step = _difference(image, last)
        quiet = step < 0.7 * self.parameters.change_levels
        self._still_ns = np.where(quiet, self._still_ns + np.float32(stamp - last_stamp), np.float32(0))
        self._past.append((stamp, image))
        while len(self._past) > 2 and stamp - self._past[1][0] > self.parameters.baseline_ns:
            self._past.popleft()
        return change

    def _lighting_only(self, image: Float32, expected: Float32, threshold: float) -> Bool:
        """Where the image is the background in a shadow or a glow: same colour, another brightness."""
        ratio = (image * expected).sum(0) / np.maximum((expected * expected).sum(0), 1)
        residual = np.abs(image - ratio * expected).max(0)
        low, high = self.parameters.shadow_darkest, self.parameters.reflection_brightest
        lit: Bool = (ratio > low) & (ratio < high) & (residual < 0.6 * threshold)
        return lit

    def _regions(self, evidence: Float32, threshold: float) -> Bool:
        """Connected regions over half the threshold that reach the threshold and are large enough, gaps closed."""
        count, labels, stats, _ = cv2.connectedComponentsWithStats((evidence > 0.5 * threshold).astype(np.uint8))
        strong = np.zeros(count, np.bool_)
        strong[labels[evidence > threshold]] = True
        strong[0] = False
        strong &= stats[:, cv2.CC_STAT_AREA] >= self.parameters.smallest_area * evidence.size
        margin = self._close.shape[0] // 2
        padded = np.pad(strong[labels].astype(np.uint8), margin)
        closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, self._close)[margin:-margin, margin:-margin]
        return closed > 0

    def _unconfirmed_holes(self, moving: Bool) -> Bool:
        """Ground enclosed by what moves that was never seen uncovered: the even inside of a thing shows no change."""
        outlines, _ = cv2.findContours(moving.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        filled = np.zeros(self.shape, np.uint8)
        cv2.drawContours(filled, outlines, -1, 1, cv2.FILLED)
        holes: Bool = (filled > 0) & ~moving & ~self._confirmed
        return holes

    def _depth_in_front(self, view: View) -> Bool:
        """Where the measured surface stands in front of the background's."""
        if view.depth is None or self._depth is None:
            return np.zeros(self.shape, np.bool_)
        known = (view.depth > 0) & (self._depth > 0)
        near = known & (view.depth < self._depth * (1 - self.parameters.depth_levels) - 0.01)
        return cv2.morphologyEx(near.astype(np.uint8), cv2.MORPH_OPEN, _disk(1)) > 0

    def _release_uncovered(
        self, image: Float32, gain: Float32, difference: Float32, change: Float32, threshold: float, candidates: Bool
    ) -> None:
        """Frees still pixels that continue the free ground beside them although the background differs there.

        Such a pixel was hidden by the thing that moved off: its old background shows that thing.
        """
        settled = candidates & self._mask & (self._still_ns > self.parameters.settle_ns) & (change < 0.5 * threshold)
        settled &= (difference > threshold) | ~self._trusted
        if not settled.any():
            return
        free = (~self._mask).astype(np.float32)
        weight = cv2.boxFilter(free, -1, (5, 5))
        beside = weight > 0.2
        sums = np.stack([cv2.boxFilter(plane * free, -1, (5, 5)) for plane in image])
        ground = (sums / np.maximum(weight, 1e-3)).astype(np.float32)
        released = settled & beside & (_difference(image, ground) < 0.6 * threshold)
        self._background[:, released] = (image / gain)[:, released]
        self._trusted |= released
        self._confirmed |= released
        self._mask &= ~released

    def _learn(self, image: Float32, view: View, free: Bool) -> None:
        """Draws the background towards the image where it is free."""
        rate = np.where(free, np.float32(self.parameters.learning_rate), np.float32(0))
        self._background += rate * (image - self._background)
        if view.depth is not None and self._depth is not None:
            deeper = (view.depth > self._depth) | (self._depth == 0)
            self._depth = np.where(free & (view.depth > 0) | deeper, view.depth, self._depth)


def _eroded(mask: Bool) -> Bool:
    """Pixels whose eight neighbours are in the mask as well."""
    return cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


def _disk(radius: int) -> UInt8:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)).astype(np.uint8)


def _planes(rgb: UInt8) -> Float32:
    """Slightly smoothed float planes [3, H, W] of an image [H, W, 3]."""
    smooth = cv2.GaussianBlur(rgb, (3, 3), 0)
    return np.ascontiguousarray(np.moveaxis(smooth, -1, 0), dtype=np.float32)


def _seen(view: View, robot: Bool | None) -> Bool:
    seen = np.ones(view.rgb.shape[:2], np.bool_) if view.valid is None else view.valid.copy()
    return seen if robot is None else seen & ~robot


def _difference(image: Float32, other: Float32) -> Float32:
    """Largest difference over the channels [H, W]."""
    largest: Float32 = np.abs(image - other).max(0)
    return largest


def _gain(image: Float32, reference: Float32, free: Bool) -> Float32:
    """Exposure ratio per channel [3, 1, 1]: the median over free pixels, so that up to half may have changed."""
    where = free[::4, ::4]
    if np.count_nonzero(where) < 50:
        return np.ones((3, 1, 1), np.float32)
    ratios = (image[:, ::4, ::4][:, where] + 4) / (reference[:, ::4, ::4][:, where] + 4)
    gain: Float32 = np.median(ratios, axis=1).astype(np.float32)[:, None, None]
    return gain
