"""What stands still in one camera's image, and how it has moved as a whole since it was first seen."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from twin_node.scene import Bool, Float32, Float64, UInt8

LK_WINDOW, LK_LEVELS = (15, 15), 3
"""Patches that are tracked, pixels, and pyramid levels: displacements up to a tenth of a small image."""
MOST_FEATURES, FEATURE_QUALITY, FEATURE_DISTANCE_PX = 160, 0.02, 5.0
BACK_PX = 0.5
"""A feature tracked there and back must come home within this."""
INLIER_PX = 0.75
"""Features within this of a motion follow it."""
LEAST_FOLLOWERS = 4
"""Points that determine a homography."""
STRAYS = 3
"""A feature that strays so often while the others stand still is on something that moves: it is dropped."""
STANDING_SHARE = 0.3
"""Share of the image that must stand still for what does not to count as stray."""
CLEAR_SHARE = 0.2
"""By how much of the image more than stands still must follow a common motion to be the camera's."""
CELLS = 4
"""The image's parts, across and down, vote: a thing with many features has no more voice than the room it takes."""
CONTRAST_PX, CONTRAST_FLOOR = 15, 4.0
"""Brightness is measured against its mean and spread over so many pixels; spreads below the floor (8-bit levels) are
noise. What light does to a patch is nearly a gain and an offset, which this takes out."""


@dataclass(frozen=True)
class CommonMotion:
    """How what stood still has moved in the image."""

    turn: Float64
    """[3] rotation vector, rad: the camera's turn, in its own optical frame, that shows them where they are now."""
    residual_px: float
    """Root mean square displacement of the landmarks under it."""
    features: int
    """Landmarks found again."""


def contrast(rgb: UInt8) -> UInt8:
    """[H, W] an image with its light taken out: 128 plus 40 local standard deviations."""
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32)
    size = (CONTRAST_PX, CONTRAST_PX)
    mean = cv2.blur(grey, size)
    variance = cv2.blur(grey * grey, size) - mean * mean
    local = (grey - mean) / (np.sqrt(np.maximum(variance, 0)) + CONTRAST_FLOOR)
    return np.asarray(np.clip(128 + 40 * local, 0, 255), np.uint8)


class Landmarks:
    """Features of one camera's reference image; those on things that move are dropped as they give themselves away."""

    def __init__(self, image: UInt8, valid: Bool | None, K: Float64, taken_at: Float64 | None = None) -> None:
        """`image` [H, W]: of `contrast`; `valid` [H, W] or None; `K` [3, 3] in gsplat's convention.

        `taken_at` [3]: the turn from home at which the image was taken, rad; None: at home.
        """
        self.reference = image
        self.home = features_of(image, valid)
        self.proven = False
        """Whether they were ever found again; those of a dark image are noise."""
        self._K = K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # features are in OpenCV's pixels
        self._taken_at = np.zeros(3) if taken_at is None else taken_at
        self._strays = np.zeros(len(self.home), dtype=np.int64)

    def __len__(self) -> int:
        return len(self.home)

    def found_in(self, image: UInt8) -> Float32:
        """[n, 2] where the landmarks are now; NaN for those that are not found, or not found back."""
        return tracked(self.reference, image, self.home)

    def motion(self, now: Float32, least_features: int, least_share: float) -> CommonMotion | None:
        """How the landmarks moved to `now` [n, 2]; None where too few are found or too few agree to say.

        The parts of the image vote on standing still and on the homography that most landmarks follow; that must win
        clearly, for it may be an arm's. Where neither wins though most landmarks are found, and hardly any at home, the
        camera has moved past things near and far: the median shift stands for that.
        """
        seen = found(now)
        if seen.sum() < least_features:
            return None
        home, there = self.home[seen], now[seen]
        standing = np.linalg.norm(there - home, axis=1) < INLIER_PX
        following = _followers(home, there)
        still, along = self._share(standing, home), self._share(following, home)
        if along >= least_share and along - still >= CLEAR_SHARE:
            return self._measured(home[following], there[following])
        if still >= least_share:
            return self._measured(home[standing], there[standing])
        if still < STANDING_SHARE / 2 and seen.mean() > least_share:
            return self._measured(home, home + np.median(there - home, axis=0))
        return None

    def agreeing(self, now: Float32) -> int:
        """How many landmarks, now at `now` [n, 2], stand or move as one: in rich images some are found by chance."""
        seen = found(now)
        home, there = self.home[seen], now[seen]
        standing = int((np.linalg.norm(there - home, axis=1) < INLIER_PX).sum())
        return standing if len(home) < LEAST_FOLLOWERS else max(standing, int(_followers(home, there).sum()))

    def stand_in(self, image: UInt8, least_features: int, least_share: float) -> bool:
        """Whether an image, of whatever camera, shows the landmarks where they are at home."""
        if image.shape != self.reference.shape:
            return False
        now = self.found_in(image)
        seen = found(now)
        standing = np.linalg.norm(now[seen] - self.home[seen], axis=1) < INLIER_PX
        return int(standing.sum()) >= least_features and self._share(standing, self.home[seen]) >= least_share

    def drop_strays(self, now: Float32) -> None:
        """Landmarks that move while much of the image stands are none; call it while the camera is steady."""
        seen = found(now)
        distance = np.linalg.norm(np.where(seen[:, None], now, self.home) - self.home, axis=1)
        if not seen.any() or self._share(distance[seen] < INLIER_PX, self.home[seen]) < STANDING_SHARE:
            return
        self._strays += distance > 2 * INLIER_PX
        kept = self._strays < STRAYS
        self.home, self._strays = self.home[kept], self._strays[kept]

    def _measured(self, home: Float32, there: Float32) -> CommonMotion:
        """The turn that shows points [n, 2] where they are now (Kabsch, 1976, on their rays)."""
        self.proven = True
        turn = Rotation.align_vectors(self._rays(home), self._rays(there))[0]
        whole = (Rotation.from_rotvec(self._taken_at) * turn).as_rotvec()
        return CommonMotion(whole, self.displacement_px(whole), len(home))

    def displacement_px(self, turn: Float64) -> float:
        """Root mean square displacement of the landmarks under a turn [3] of the camera, rad; pixels."""
        if not len(self.home):
            return 0.0
        rays = Rotation.from_rotvec(turn).inv().apply(self._rays(self.home)) @ self._K.T
        moved = rays[:, :2] / rays[:, 2:] - self.home
        return float(np.sqrt((moved**2).sum(1).mean()))

    def _rays(self, points: Float32) -> Float64:
        """[n, 3] of length 1 through pixels [n, 2], in the optical frame."""
        rays = np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(self._K).T
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def _share(self, rows: Bool, points: Float32) -> float:
        """Share of the points [n, 2] under a mask [n]: the mean over the parts of the image that have some."""
        height, width = self.reference.shape
        column, row = (points / [width, height] * CELLS).astype(np.int64).clip(0, CELLS - 1).T
        counts = np.bincount(row * CELLS + column, minlength=CELLS * CELLS)
        hits = np.bincount(row * CELLS + column, weights=rows, minlength=CELLS * CELLS)
        return float((hits[counts > 0] / counts[counts > 0]).mean())


def features_of(image: UInt8, valid: Bool | None) -> Float32:
    """[n, 2] corners of an image [H, W] worth tracking, `valid` [H, W] and off its edges."""
    mask = None if valid is None else cv2.erode(valid.astype(np.uint8) * 255, np.ones((9, 9), np.uint8))
    found = cv2.goodFeaturesToTrack(image, MOST_FEATURES, FEATURE_QUALITY, FEATURE_DISTANCE_PX, mask=mask)
    return np.zeros((0, 2), np.float32) if found is None else np.asarray(found, np.float32).reshape(-1, 2)


def tracked(reference: UInt8, image: UInt8, points: Float32) -> Float32:
    """[n, 2] where points [n, 2] of one image are in another; NaN for those that are not found, or not found back."""
    if not len(points):
        return points.copy()
    there, found = _flow(reference, image, points)
    back, returned = _flow(image, reference, there)
    good = found & returned & (np.linalg.norm(back - points, axis=1) < BACK_PX)
    return np.where(good[:, None], there, np.nan).astype(np.float32)


def found(now: Float32) -> Bool:
    """[n] which of the places [n, 2] that `tracked` returned are known."""
    return np.asarray(np.isfinite(now).all(axis=1))


def _flow(a: UInt8, b: UInt8, points: Float32) -> tuple[Float32, Bool]:
    """Points [n, 2] of image `a` as tracked in `b`, and which were found."""
    there, found, _ = cv2.calcOpticalFlowPyrLK(a, b, points, points.copy(), winSize=LK_WINDOW, maxLevel=LK_LEVELS)
    return np.asarray(there, np.float32), np.asarray(found).ravel() > 0


def _followers(home: Float32, there: Float32) -> Bool:
    """[n] which points follow the homography that most do: what a turn does to an image, whatever its size."""
    _, inside = cv2.findHomography(home, there, cv2.RANSAC, INLIER_PX)
    return np.zeros(len(home), np.bool_) if inside is None else np.asarray(inside.ravel() > 0)
