"""Watches whether cameras stay where they were calibrated: what stands still must stay still in their images."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.scene import Bool, Camera, Float32, Float64, FrameSet, UInt8, View

LK_WINDOW, LK_LEVELS = (15, 15), 3
"""Patches that are tracked, pixels, and pyramid levels: displacements up to a tenth of a small image."""
MOST_FEATURES, FEATURE_QUALITY, FEATURE_DISTANCE_PX = 200, 0.01, 5.0
BACK_PX = 0.5
"""A feature tracked there and back must come home within this."""
INLIER_PX = 0.75
"""Features within this of the common motion follow it."""
STRAYS = 3
"""A feature that strays so often while the others stand still is on something that moves: it is dropped."""


@dataclass(frozen=True)
class DriftParameters:
    """When a camera counts as bumped."""

    angle_deg: float = 0.3
    """Turn from which a camera is named: at 1 m it puts things 5 mm off."""
    least_px: float = 0.35
    """The same in pixels of the images watched: below it tracking noise rules."""
    confirm: int = 4
    """Checks in a row that must agree before a camera is named, or cleared again."""
    period_ms: float = 100.0
    """Time between two checks of a camera."""
    least_features: int = 15
    """Features that must be seen for a verdict."""
    least_share: float = 0.5
    """Share of the features seen that must move as one: otherwise too much is in the way, and nothing is said."""


@dataclass(frozen=True)
class Drift:
    """What the last check of a camera found."""

    camera: str
    residual_px: float
    """Root mean square displacement of static features from where they were, pixels of the images watched."""
    angle_deg: float
    """The turn that would explain it."""
    features: int
    """Static features that it is judged by; 0 where too few were found."""
    bumped: bool


class DriftWatch:
    """Names cameras that are no longer where they were when the watch began.

    A textured image in which the static features are gone altogether counts as one of a bumped camera: nothing vouches
    for it. A covered or dark one gives no verdict. Call `reset` after a calibration, or when the cell was rearranged.
    """

    def __init__(self, parameters: DriftParameters | None = None) -> None:
        self._parameters = parameters or DriftParameters()
        self._cameras: dict[str, _Watched] = {}

    def update(self, frames: FrameSet) -> tuple[str, ...]:
        """Takes a set of undistorted images in the order of their stamps; returns the names of bumped cameras."""
        for view in frames.views:
            watched = self._cameras.get(view.camera.name)
            if watched is None:
                self._cameras[view.camera.name] = _Watched(view.camera, _grey(view), view.stamp, view.valid)
            elif view.stamp - watched.checked >= self._parameters.period_ms * 1e6:
                watched.check(_grey(view), view.stamp, self._parameters)
        return tuple(name for name, watched in self._cameras.items() if watched.drift.bumped)

    @property
    def drifts(self) -> tuple[Drift, ...]:
        """What the last check of every camera found, for diagnostics."""
        return tuple(watched.drift for watched in self._cameras.values())

    def reset(self) -> None:
        """Forgets everything: where the cameras stand now becomes where they belong."""
        self._cameras.clear()


@dataclass
class _Watched:
    """One camera's reference and what became of it."""

    camera: Camera
    reference: UInt8
    checked: int
    valid: Bool | None
    home: Float32 = field(init=False)
    """[n, 2] where features belong."""
    strays: NDArray[np.int64] = field(init=False)
    drift: Drift = field(init=False)
    suspicions: int = 0

    def __post_init__(self) -> None:
        self.home = _features(self.reference, self.valid)
        self.strays = np.zeros(len(self.home), dtype=np.int64)
        self.drift = Drift(self.camera.name, 0.0, 0.0, len(self.home), False)

    def check(self, image: UInt8, stamp: int, parameters: DriftParameters) -> None:
        """Compares an image with the reference and remembers the verdict."""
        self.checked = stamp
        tracked = _tracked(self.reference, image, self.home)
        seen = np.asarray(np.isfinite(tracked).all(axis=1))
        motion = _common_motion(self.home[seen], tracked[seen], parameters)
        if motion is None:
            gone = seen.sum() < parameters.least_features <= len(_features(image, self.valid))
            self._judge(self.drift.residual_px, self.drift.angle_deg, 0, gone, parameters)
            return
        moved = self.home @ motion[:, :2].T + motion[:, 2] - self.home
        residual = float(np.sqrt((moved**2).sum(1).mean()))
        angle = float(np.degrees(residual / self.camera.K[0, 0]))
        off = angle > parameters.angle_deg and residual > parameters.least_px
        self._judge(residual, angle, int(seen.sum()), off, parameters)
        if not off:
            self._drop_strays(tracked, seen)

    def _drop_strays(self, tracked: Float32, seen: Bool) -> None:
        """Features that move while the camera stands are none to judge it by."""
        distance = np.linalg.norm(np.where(seen[:, None], tracked, self.home) - self.home, axis=1)
        self.strays += distance > 2 * INLIER_PX
        kept = self.strays < STRAYS
        self.home, self.strays = self.home[kept], self.strays[kept]

    def _judge(self, residual: float, angle: float, features: int, off: bool, parameters: DriftParameters) -> None:
        """A verdict changes once enough checks in a row speak against it."""
        self.suspicions = self.suspicions + 1 if off != self.drift.bumped else 0
        bumped = off if self.suspicions >= parameters.confirm else self.drift.bumped
        self.drift = Drift(self.camera.name, residual, angle, features, bumped)


def _grey(view: View) -> UInt8:
    """Brightness with the exposure taken out, which may jump from image to image."""
    return np.asarray(cv2.equalizeHist(cv2.cvtColor(view.rgb, cv2.COLOR_RGB2GRAY)), dtype=np.uint8)


def _features(image: UInt8, valid: Bool | None) -> Float32:
    """[n, 2] corners worth tracking."""
    mask = None if valid is None else cv2.erode(valid.astype(np.uint8) * 255, np.ones((9, 9), np.uint8))
    found = cv2.goodFeaturesToTrack(image, MOST_FEATURES, FEATURE_QUALITY, FEATURE_DISTANCE_PX, mask=mask)
    return np.zeros((0, 2), np.float32) if found is None else np.asarray(found, np.float32).reshape(-1, 2)


def _tracked(reference: UInt8, image: UInt8, home: Float32) -> Float32:
    """[n, 2] where features are now; NaN for those that are not found, or not found back."""
    if not len(home):
        return home.copy()
    there, found = _flow(reference, image, home)
    back, returned = _flow(image, reference, there)
    good = found & returned & (np.linalg.norm(back - home, axis=1) < BACK_PX)
    return np.where(good[:, None], there, np.nan).astype(np.float32)


def _flow(a: UInt8, b: UInt8, points: Float32) -> tuple[Float32, Bool]:
    """Points [n, 2] of image `a` as tracked in `b`, and which were found."""
    there, found, _ = cv2.calcOpticalFlowPyrLK(a, b, points, points.copy(), winSize=LK_WINDOW, maxLevel=LK_LEVELS)
    return np.asarray(there, np.float32), np.asarray(found).ravel() > 0


def _common_motion(home: Float32, now: Float32, parameters: DriftParameters) -> Float64 | None:
    """[2, 3] similarity that most features follow; None where too few are seen or agree."""
    if len(home) < parameters.least_features:
        return None
    motion, inside = cv2.estimateAffinePartial2D(home, now, method=cv2.RANSAC, ransacReprojThreshold=INLIER_PX)
    if motion is None or inside.mean() < parameters.least_share:
        return None
    return np.asarray(motion, dtype=np.float64)
