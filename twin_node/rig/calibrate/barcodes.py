"""How well a rig explains what moves in a recording, without matching anything: by line motion barcodes.

Two cameras and a point in space lie in one epipolar plane, so at every time the planes in which one camera sees motion
are those in which the other does (Ben-Artzi, Kasten, Peleg and Werman, "Camera calibration from dynamic silhouettes
using motion barcodes", CVPR 2016). Half-planes about the line between the cameras are compared, so that a camera that
looks the wrong way is told apart. The scale of a rig cannot be told so.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.rig.calibrate.lenses import homogeneous, pixel_rays
from twin_node.scene import Bool, Float64, FrameSet, Rig, RigCamera, UInt8
from twin_node.thinning import thinned

MOVING_LEVELS = 25
"""Difference from the median image, 8-bit levels in some channel, from which a pixel counts as moving."""
LEAST_MOVING = 0.003
"""Smallest moving share of an image that tells anything: below it is noise."""
MOST_SETS, LEAST_SETS = 36, 6
"""Sets compared at most, evenly picked from those in which something moves; fewer than the least tell nothing."""
BLOCKS = 6
"""The sets are judged in so many blocks of time: their scatter tells how sure the mean is."""
PLANE_PX = 1.5
"""Width of a half-plane's bin in the image, pixels."""
LEAST_PIXELS, LEAST_PLANES = 4, 8
"""Pixels that a bin, and bins that two cameras, must share to be compared."""


class Barcodes:
    """Which parts of the images move when, ready to be compared under any rig of the same cameras."""

    def __init__(self, rig: Rig, sets: Iterable[FrameSet]) -> None:
        """`sets` of raw images, distorted as the cameras see them, of any size."""
        images = _by_set(rig, sets)
        self._shapes = [next((row[i].shape[:2] for row in images if i in row), (0, 0)) for i in range(len(rig.cameras))]
        self._moving = thinned(_moving(images, len(rig.cameras)), MOST_SETS)
        self._known_rays: dict[bytes, Float64] = {}
        self._known_scores: dict[tuple[int, int, bytes], Float64] = {}

    @property
    def tells(self) -> bool:
        """Whether enough moves for a verdict."""
        return len(self._moving) >= LEAST_SETS

    def agreement(self, rig: Rig) -> Float64:
        """[B] how well a rig explains the motion in every block of sets, 1: fully, 0: no better than chance.

        The mean over the pairs of cameras of Matthews' correlation between their barcodes.
        """
        pairs = combinations(range(len(rig.cameras)), 2)
        return np.asarray(np.mean([self._scores(rig, a, b) for a, b in pairs], axis=0))

    def _scores(self, rig: Rig, a: int, b: int) -> Float64:
        """[B] of two cameras; those of pairs that a changed rig leaves alone are remembered."""
        pair = (rig.cameras[a], rig.cameras[b])
        key = (a, b, b"".join(_identity(camera) + camera.T_base_cam.tobytes() for camera in pair))
        if key not in self._known_scores:
            counts = self._counts(rig, (a, b))
            blocks = np.array_split(np.arange(len(self._moving)), BLOCKS)
            self._known_scores[key] = np.array([_correlation(counts[block].sum(0)) for block in blocks])
        return self._known_scores[key]

    def _rays(self, number: int, camera: RigCamera) -> Float64:
        """[H * W, 3] directions, in the base frame, that the pixels of the reduced images of a camera look along."""
        shape = self._shapes[number]
        key = _identity(camera) + repr(shape).encode()
        if key not in self._known_rays:
            rows, columns = np.mgrid[: shape[0], : shape[1]]
            pixels = (np.column_stack([columns.ravel(), rows.ravel()]) + 0.5) * (camera.width / shape[1]) - 0.5
            self._known_rays[key] = homogeneous(pixel_rays(camera, pixels))
        return np.asarray(self._known_rays[key] @ camera.T_base_cam[:3, :3].T)

    def _counts(self, rig: Rig, pair: tuple[int, int]) -> Float64:
        """[S, 4] per set the share of common half-planes that move in both images, in a only, in b only, in neither."""
        a, b = (rig.cameras[i] for i in pair)
        width = min(self._shapes[i][1] for i in pair)
        size = int(2 * np.pi * abs(a.K[0, 0]) * width / a.width / PLANE_PX)
        bins = [_half_planes(a, b, self._rays(i, rig.cameras[i]), size) for i in pair]
        common = np.all([np.bincount(own, minlength=size)[:size] >= LEAST_PIXELS for own in bins], axis=0)
        counts, planes = np.zeros((len(self._moving), 4)), np.count_nonzero(common)
        if planes < LEAST_PLANES:
            return counts
        for row, moving in zip(counts, self._moving, strict=True):
            if pair[0] in moving and pair[1] in moving:
                in_a, in_b = (_hit(own[moving[i]], size)[common] for own, i in zip(bins, pair, strict=True))
                both, first, second = (np.count_nonzero(hit) for hit in (in_a & in_b, in_a, in_b))
                row[:] = both, first - both, second - both, planes - first - second + both
        return counts / planes


def _identity(camera: RigCamera) -> bytes:
    """What tells one lens from another."""
    return camera.K.tobytes() + camera.D.tobytes() + camera.distortion_model.encode()


def _by_set(rig: Rig, sets: Iterable[FrameSet]) -> list[dict[int, UInt8]]:
    numbers = {camera.name: i for i, camera in enumerate(rig.cameras)}
    return [{numbers[view.camera.name]: view.rgb for view in frames.views} for frames in sets]


def _moving(images: Sequence[dict[int, UInt8]], cameras: int) -> list[dict[int, NDArray[np.int64]]]:
    """Per set in which something moves before two cameras: camera -> flat indices of the pixels that do."""
    found: list[dict[int, NDArray[np.int64]]] = [{} for _ in images]
    for i in range(cameras):
        own = [(number, row[i]) for number, row in enumerate(images) if i in row]
        still = np.median([image for _, image in own], axis=0) if own else np.zeros(0)
        bounds = np.ceil(still - MOVING_LEVELS), np.floor(still + MOVING_LEVELS)
        low, high = (np.clip(bound, 0, 255).astype(np.uint8) for bound in bounds)
        for number, image in own:
            off = cv2.inRange(image, low, high) == 0
            mask = cv2.morphologyEx(off.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
            if mask.mean() > LEAST_MOVING:
                found[number][i] = np.flatnonzero(mask)
    return [row for row in found if len(row) > 1]


def _half_planes(a: RigCamera, b: RigCamera, rays: Float64, size: int) -> NDArray[np.int64]:
    """[n] which of `size` half-planes about the line through both cameras each ray [n, 3] lies in; `size` of NaN."""
    base = b.T_base_cam[:3, 3] - a.T_base_cam[:3, 3]
    across = np.linalg.svd(base[None])[2][1:]
    angles = np.arctan2(rays @ across[1], rays @ across[0]) / (2 * np.pi) + 0.5
    lies = np.isfinite(angles)
    return np.where(lies, np.minimum((np.where(lies, angles, 0.0) * size).astype(np.int64), size - 1), size)


def _hit(bins: NDArray[np.int64], size: int) -> Bool:
    """[size] which half-planes are among the bins [n]."""
    hit = np.zeros(size + 1, np.bool_)
    hit[bins] = True
    return hit[:size]


def _correlation(counts: Float64) -> float:
    """Matthews' correlation of a table [4]: both, first only, second only, neither."""
    both, first, second, neither = counts
    spread = np.sqrt((both + first) * (both + second) * (neither + first) * (neither + second))
    return float((both * neither - first * second) / spread) if spread > 0 else 0.0
