"""One camera's moving mask, in NumPy: what the compiled one does in one go, and the reference that it is held to."""

from __future__ import annotations

from collections import deque

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from twin_node.model.ground_depth import LEARNING_RATE, TELLING, GroundDepth, middle, with_noise
from twin_node.scene import Bool, Float32, UInt8, View

CHANGE_SIGMAS = 6.0
"""A pixel has changed when it differs by this many times the image's own noise (1 sigma, measured)."""
CHANGE_LEVELS = 9.0
"""Smallest difference that counts, in 8-bit levels: below it lie compression artefacts."""
LEAST_NOISE, USUAL_NOISE, MOST_FIRST_NOISE = 0.5, 1.45, 20.0
"""What an image's noise is taken to be at least, at first, and by the first two images at most, 1 sigma, levels."""
BASELINE_NS = 100_000_000
"""An image is compared with one this much older: slow limbs move a pixel in 100 ms, not between two frames."""
SETTLE_NS = 120_000_000
"""A pixel still for this long may be recognised as uncovered background."""
SMALLEST_AREA = 6e-4
"""Smallest moving region as a share of the image; less is noise."""
GAP = 0.03
"""Gaps inside a moving thing up to this share of the image's shorter side are closed."""
SHADOW_DARKEST = 0.7
"""A cast shadow keeps at least this share of the background's brightness (and its colour)."""
REFLECTION_BRIGHTEST = 1.2
"""A reflected glow adds at most up to this multiple of the background's brightness."""
GROUND_CERTAINTY = 0.7
"""A settled pixel of a colour this surely ground's is ground, if it touches ground."""
GROUND_LIKELIHOOD = 0.4
"""A settled pixel of a colour this likely ground's is ground, if it fits the ground beside it clearly better than
what the background held there does: textured ground that a thing, there from the start, has moved off."""
GROUND_AROUND = 0.85
"""A settled pixel that looks like a background which may show the moving thing itself is ground if so large a share
of the 5 x 5 pixels around it surely is, and its depth is known: alone among ground it would hold its neighbours."""
GROWTH_PIXELS = 3
"""Rings of uncovered ground found per image; each ring is two pixels wide."""


class CameraMask:
    """One camera's background and the mask of what stands out from it. Images are float planes [3, H, W]."""

    def __init__(self, view: View) -> None:
        self.shape = view.rgb.shape[:2]
        self.background = _planes(view.rgb)
        self.depth = GroundDepth(view)
        self.known = np.zeros(self.shape, np.bool_)  # False where nothing but the robot has been seen yet
        self.trusted = np.ones(self.shape, np.bool_)  # False where the background may show the moving thing itself
        self.confirmed = np.zeros(self.shape, np.bool_)  # was covered once, and is known to be ground since
        self.mask = np.zeros(self.shape, np.bool_)
        self.still_ns = np.zeros(self.shape, np.float32)
        self.sigma = 0.0  # noise, levels; 0 until there are two images
        self.bared = 0.0  # pixels of late that something moved off which had been there from the start; without depth
        self.past: deque[tuple[int, Float32]] = deque([(view.stamp, self.background.copy())])
        self.closing = _disk(max(1, round(GAP * min(self.shape))))
        self.colours = Colours()

    @property
    def ground_depth(self) -> Float32:
        """[H, W] m, how deep the ground is that has been seen; 0 where none has, or no depth of it."""
        return np.where(self.known, self.depth.known, np.float32(0))

    def update(self, view: View, robot: Bool | None) -> Bool:
        """The mask [H, W] of this view."""
        image = _planes(view.rgb)
        seen = seen_by(view, robot)
        self.depth.measure_noise(view, seen & ~self.mask)
        gain = _gain(image, self.background, seen & ~self.mask & self.known)
        self._meet(image / gain, view, seen & ~self.known & ~self.depth.stands_before(view, seen))
        free = seen & ~self.mask
        told = self.depth.look(view, view.stamp - self.past[-1][0], seen, free)
        settled = self._settled(image, view.stamp, free)
        threshold = max(CHANGE_LEVELS, CHANGE_SIGMAS * self.sigma)
        expected = self.background * gain
        difference = np.where(self._lighting_only(image, expected, threshold), 0, _difference(image, expected))
        moving = self._regions(np.where(self.trusted & seen, difference, 0), threshold) | told.in_front
        like_ground = difference < 0.5 * threshold
        ground = self.trusted & like_ground & ~told.lost
        mask = moving | (self.mask & ~_eroded(ground | ~seen))  # what the arm hides holds nothing
        mask = (mask | self._unconfirmed_holes(mask)) & seen
        is_known = self.depth.known > 0  # elsewhere nothing else would notice somebody of the ground's colours
        freed = self.confirmed & is_known
        self.trusted &= ~(mask & ~self.mask & ~freed & like_ground & ~self.depth.come(view, told.in_front))
        object_ = self.confirmed & self.trusted & (difference > threshold)
        measured = is_known & (self.depth.blind_ns < self.still_ns)  # since it looks as it does
        free = seen & ~mask
        bared = told.telling & ~measured & ~most_around(is_known, free, TELLING)  # of a thing, off what is not measured
        by_depth = measured | bared
        settled &= mask & ~told.rim & (by_depth | ~told.telling)
        among_ground = settled & ~self.trusted & like_ground & is_known
        among_ground &= most_around(seen & self.trusted & like_ground, np.ones_like(seen), GROUND_AROUND)
        uncovered = self._uncovered(image / gain, settled, free, among_ground, object_, by_depth, threshold)
        uncovered &= (difference > threshold) | ~self.trusted
        self.confirmed |= (self.mask & ~mask & seen) | uncovered
        if not self.depth.is_told:
            self.bared = 0.98 * self.bared + np.count_nonzero(uncovered & self.trusted & (difference > threshold))
        self.trusted |= uncovered
        self.mask = mask & ~uncovered
        self.depth.forget(uncovered & bared)
        self._learn(image / gain, view, seen & ~self.mask, uncovered)
        return self.mask.copy()

    def reference(self, stamp: int) -> Float32:
        """[3, H, W] the oldest image up to a baseline older than `stamp` (ns); the newest where there is none."""
        recent = (past for at, past in self.past if stamp - at <= BASELINE_NS)
        return next(recent, self.past[-1][1])

    def remember(self, stamp: int, image: Float32) -> None:
        """Keeps the image [3, H, W] of `stamp` (ns) for as long as others are compared with it."""
        self.past.append((stamp, image))
        while len(self.past) > 2 and stamp - self.past[1][0] > BASELINE_NS:
            self.past.popleft()

    def take_for_ground(self, where: Bool, view: View) -> None:
        """What the newest image, of `view`, shows `where` [H, W] is ground from now on, as somebody knows."""
        image, free = self.past[-1][1], self.known & ~self.mask & ~where
        gain = _gain(image, self.background, free)
        self.background[:, where] = (image / gain)[:, where]
        self.depth.meet(view, where)
        self.known |= where
        self.trusted |= where
        self.confirmed |= where
        self.mask &= ~where

    def _meet(self, image: Float32, view: View, fresh: Bool) -> None:
        """Takes pixels that are seen for the first time as the scene at rest, unless they touch what moves."""
        if not fresh.any():
            return
        self.known |= fresh
        self.background[:, fresh] = image[:, fresh]
        self.depth.meet(view, fresh)
        doubtful = fresh & (cv2.dilate(self.mask.astype(np.uint8), self.closing) > 0)
        self.trusted &= ~doubtful
        self.mask |= doubtful

    def _settled(self, image: Float32, stamp: int, free: Bool) -> Bool:
        """Pixels that look as they did one baseline ago and have been still since; measures the noise on the way."""
        reference, quiet = self.reference(stamp), 0.7 * max(CHANGE_LEVELS, CHANGE_SIGMAS * self.sigma)
        change = _difference(image, reference * _gain(image, reference, free))
        last_stamp, last = self.past[-1]
        sample = change[::4, ::4][free[::4, ::4]]
        if sample.size > 50 and stamp > last_stamp:
            noise = max(LEAST_NOISE, 1.48 * float(middle(sample)))
            self.sigma = with_noise(self.sigma, noise, USUAL_NOISE, MOST_FIRST_NOISE)
        is_still = _difference(image, last) < quiet
        self.still_ns = np.where(is_still, self.still_ns + np.float32(stamp - last_stamp), np.float32(0))
        self.remember(stamp, image)
        settled: Bool = (self.still_ns > SETTLE_NS) & (change < quiet)
        return settled

    def _lighting_only(self, image: Float32, expected: Float32, threshold: float) -> Bool:
        """Where the image is the background in a shadow or a glow: same colour, another brightness."""
        ratio = (image * expected).sum(0) / np.maximum((expected * expected).sum(0), 1)
        residual = _difference(image, ratio * expected)
        low, high = SHADOW_DARKEST, REFLECTION_BRIGHTEST
        lit: Bool = (ratio > low) & (ratio < high) & (residual < 0.6 * threshold)
        return lit

    def _regions(self, evidence: Float32, threshold: float) -> Bool:
        """Connected regions over half the threshold that reach the threshold and are large enough, gaps closed."""
        count, labels, stats, _ = cv2.connectedComponentsWithStats((evidence > 0.5 * threshold).astype(np.uint8))
        strong = np.zeros(count, np.bool_)
        strong[labels[evidence > threshold]] = True
        strong[0] = False
        strong &= stats[:, cv2.CC_STAT_AREA] >= SMALLEST_AREA * evidence.size
        return self._closed(strong[labels])

    def _unconfirmed_holes(self, mask: Bool) -> Bool:
        """Ground enclosed by what moves that was never seen uncovered: the even inside of a thing shows no change."""
        closed = self._closed(mask)
        outlines, _ = cv2.findContours(closed.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        filled = np.zeros(self.shape, np.uint8)
        cv2.drawContours(filled, outlines, -1, 1, cv2.FILLED)
        inside = cv2.dilate(((filled > 0) & ~closed).astype(np.uint8), self.closing) > 0
        holes: Bool = inside & (filled > 0) & ~mask & ~self.confirmed
        return holes

    def _closed(self, mask: Bool) -> Bool:
        """The mask with gaps up to the kernel's width closed."""
        margin = self.closing.shape[0] // 2
        padded = np.pad(mask.astype(np.uint8), margin)
        closed: Bool = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, self.closing)[margin:-margin, margin:-margin] > 0
        return closed

    def _uncovered(
        self,
        image: Float32,
        settled: Bool,
        free: Bool,
        found: Bool,
        object_: Bool,
        by_depth: Bool,
        threshold: float,
    ) -> Bool:
        """`found`, and settled pixels that a thing, there from the start, has moved off: ground never seen before.

        They continue the free ground beside them, or have a colour of the ground around and not of moving things. Where
        this is not told `by_depth`, colours alone must tell them from somebody who has come to rest: there they must
        also fit better than the background did, and what is doubted must be likely ground.
        """
        self.colours.learn(image, free, object_)
        if not settled.any():
            return found
        unknown = np.where(by_depth, np.float32(0), np.float32(0.5))
        share = self.colours.shares(image, unknown)
        likelier = share >= self.colours.shares(self.background, unknown)
        ground_coloured = settled & (share > GROUND_CERTAINTY)
        likely_ground = settled & (share > GROUND_LIKELIHOOD)
        box = _around(settled, 2)  # what is found is settled, and looks no farther than its 5 x 5 pixels
        image, background, inside = image[:, *box], self.background[:, *box], found[box]
        for _ in range(GROWTH_PIXELS):
            known = (free[box] | inside).astype(np.float32)
            weight = cv2.boxFilter(known, -1, (5, 5))
            sums = np.stack([cv2.boxFilter(plane * known, -1, (5, 5)) for plane in image])
            ground = (sums / np.maximum(weight, 1e-3)).astype(np.float32)
            rough, was_rough = _difference(image, ground), _difference(background, ground)
            better = rough < 0.7 * was_rough
            fits_better = likely_ground[box] & (was_rough > 2 * threshold) & better
            continues = (settled[box] & (rough < 0.6 * threshold)) | fits_better
            is_ground = continues | ground_coloured[box]
            is_ground &= by_depth[box] | np.where(self.trusted[box], better & likelier[box], likely_ground[box])
            inside |= (weight > 0.2) & is_ground
        return found

    def _learn(self, image: Float32, view: View, free: Bool, uncovered: Bool) -> None:
        """Draws the background towards the image where it is free, and takes what was uncovered at once."""
        learning_rate = np.float32(LEARNING_RATE)
        rate = np.where(free, np.where(uncovered, np.float32(1), learning_rate), np.float32(0))
        self.background += rate * (image - self.background)
        self.depth.learn(view, rate, free)


class Colours:
    """How often each colour is free ground and how often a moving thing, in bins of 16 levels per channel."""

    def __init__(self) -> None:
        self.ground = np.zeros(16**3)
        self.moving = np.zeros(16**3)

    def learn(self, image: Float32, ground: Bool, moving: Bool) -> None:
        """Counts the pixels of both; older counts fade over about 50 images."""
        bins = self._bins(image)
        self.ground = 0.98 * self.ground + np.bincount(bins[ground], minlength=self.ground.size)
        self.moving = 0.98 * self.moving + np.bincount(bins[moving], minlength=self.moving.size)

    def shares(self, image: Float32, unknown: Float32) -> Float32:
        """[H, W] how probably a pixel of this colour is ground; `unknown` [H, W] until moving things have been seen."""
        if self.moving.sum() < 200:
            return unknown
        on_ground, on_moving = (_smooth(counts / max(counts.sum(), 1)) for counts in (self.ground, self.moving))
        share = on_ground / np.maximum(on_ground + on_moving, 1e-9)
        return share.astype(np.float32)[self._bins(image)]

    @staticmethod
    def _bins(image: Float32) -> NDArray[np.intp]:
        levels = (np.clip(image, 0, 255) / 16).astype(np.int16)
        bins: NDArray[np.intp] = ((levels[0] * 16 + levels[1]) * 16 + levels[2]).astype(np.intp)
        return bins


def _smooth(density: NDArray[np.float64]) -> NDArray[np.float64]:
    """A colour density spread over its neighbouring bins."""
    cube: NDArray[np.float64] = uniform_filter(density.reshape(16, 16, 16), 3, mode="nearest")
    return cube.ravel()


def _eroded(mask: Bool) -> Bool:
    """Pixels whose eight neighbours are in the mask as well."""
    return cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


def _around(mask: Bool, margin: int) -> tuple[slice, slice]:
    """Rows and columns that hold all True pixels, of which there are some, and `margin` more."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return (
        slice(max(int(rows[0]) - margin, 0), int(rows[-1]) + margin + 1),
        slice(max(int(columns[0]) - margin, 0), int(columns[-1]) + margin + 1),
    )


def _disk(radius: int) -> UInt8:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)).astype(np.uint8)


def _planes(rgb: UInt8) -> Float32:
    """Slightly smoothed float planes [3, H, W] of an image [H, W, 3]."""
    smooth = cv2.GaussianBlur(rgb, (3, 3), 0)
    return np.ascontiguousarray(np.moveaxis(smooth, -1, 0), dtype=np.float32)


def most_around(of: Bool, among: Bool, share: float) -> Bool:
    """[H, W] pixels about which so large a share of those `among` the 5 x 5 is `of` these, or none is among them."""
    counts = [
        cv2.boxFilter(one.astype(np.float32), -1, (5, 5), normalize=False, borderType=cv2.BORDER_CONSTANT)
        for one in (of & among, among)
    ]
    most: Bool = counts[0] >= share * counts[1].astype(np.float64)
    return most


def seen_by(view: View, robot: Bool | None) -> Bool:
    seen = np.ones(view.rgb.shape[:2], np.bool_) if view.valid is None else view.valid.copy()
    return seen if robot is None else seen & ~robot


def _difference(image: Float32, other: Float32) -> Float32:
    """Largest difference over the channels [H, W]."""
    apart = np.abs(image - other)
    largest: Float32 = np.maximum(np.maximum(apart[0], apart[1]), apart[2])
    return largest


def _gain(image: Float32, reference: Float32, free: Bool) -> Float32:
    """Exposure ratio per channel [3, 1, 1]: the median over free pixels, so that up to half may have changed."""
    where = free[::4, ::4]
    if np.count_nonzero(where) < 50:
        return np.ones((3, 1, 1), np.float32)
    ratios = (image[:, ::4, ::4][:, where] + 4) / (reference[:, ::4, ::4][:, where] + 4)
    gain: Float32 = middle(ratios)[:, None, None]
    return gain
