"""An RGB-D camera's own errors: lens blur, colour noise, depth noise that grows with distance, missing depth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.cell.kernel_requests import ColourRequest, DepthRequest
from twin_node.cell.kernels import kernels
from twin_node.cell.rendering import Rendering
from twin_node.cell.scenario import Sensing
from twin_node.native_library import addresses_of
from twin_node.scene import Float32, UInt8

LENS_SIGMA_PX = 0.6
"""Blur of lens and pixel area, 1 sigma, pixels."""

DEPTH_STEP = 0.04
"""Change of depth inside 3 x 3 pixels, as a share of the depth, that counts as a step."""

SHORTEST_M = 0.1
"""Nearer depth has steps as if it were this, m."""


FARTHEST_MM = 65_535
"""Depth that 16 bits do not hold is unknown."""


@dataclass(frozen=True)
class RawImage:
    """What a camera sends."""

    camera: str
    stamp: int
    """Mid-exposure as the camera tells it, ns."""
    rgb: UInt8
    """[H, W, 3]."""
    depth_mm: NDArray[np.uint16]
    """[H, W] along the optical axis; 0 where unknown."""
    depth_is_nan: bool = False
    """The camera sends NaN instead of `depth_mm`."""

    @property
    def depth_m(self) -> Float32:
        """[H, W] depth as it is published, m; 0 where it is unknown."""
        if self.depth_is_nan:
            return np.zeros(self.depth_mm.shape, np.float32)
        return self.depth_mm.astype(np.float32) / np.float32(1000)


class Noise(Protocol):
    """Where a sensor's chances come from: a generator of NumPy's, or `DrawnNoise`."""

    def standard_normal(self, size: tuple[int, ...], dtype: type[np.float32]) -> Float32:
        """Normal numbers of mean 0 and deviation 1."""

    def random(self, size: tuple[int, ...], dtype: type[np.float32]) -> Float32:
        """Numbers of [0, 1), equally likely."""


class DrawnNoise:
    """Noise drawn once, of which every image takes a part; drawn anew it takes half of an image's processor time.

    Two images have some of it in common, each elsewhere. For images that nobody compares with those of another run.
    """

    _PARTS = 4
    """So many times the noise of one image are drawn."""

    def __init__(self, pixels: int, seed: int) -> None:
        """`pixels`: of the largest image."""
        rng = np.random.default_rng(seed)
        self._normals = rng.standard_normal(3 * pixels * self._PARTS, dtype=np.float32)
        self._chances = rng.random(pixels * self._PARTS, dtype=np.float32)

    def part_of(self, rng: np.random.Generator) -> Noise:
        """That of one image; `rng` says which."""
        return _PartOfNoise(self._normals, self._chances, rng)


@dataclass(frozen=True)
class _PartOfNoise:
    normals: Float32
    chances: Float32
    rng: np.random.Generator

    def standard_normal(self, size: tuple[int, ...], dtype: type[np.float32]) -> Float32:
        return self._part(self.normals, size)

    def random(self, size: tuple[int, ...], dtype: type[np.float32]) -> Float32:
        return self._part(self.chances, size)

    def _part(self, drawn: Float32, size: tuple[int, ...]) -> Float32:
        count = int(np.prod(size))
        first = int(self.rng.integers(len(drawn) - count + 1))
        return drawn[first : first + count].reshape(size)


def sense(camera: str, stamp: int, rendering: Rendering, sensing: Sensing, noise: Noise) -> RawImage:
    """The image that a camera with the errors of `sensing` makes of a perfect one."""
    rgb, depth = _noisy_rgb(rendering.rgb, sensing, noise), _noisy_depth(rendering.depth, sensing, noise)
    return RawImage(camera, stamp, rgb, depth)


def _noisy_rgb(rgb: UInt8, sensing: Sensing, chances: Noise) -> UInt8:
    blurred = np.asarray(cv2.GaussianBlur(rgb, (3, 3), LENS_SIGMA_PX), np.uint8)
    noise = chances.standard_normal(rgb.shape, dtype=np.float32)
    compiled = kernels()
    if compiled is None:
        sensed: UInt8 = np.clip(blurred + noise * np.float32(sensing.rgb_sigma) + 0.5, 0, 255).astype(np.uint8)
        return sensed
    sensed = np.empty_like(blurred)
    compiled.run(ColourRequest(rgb.size, sensing.rgb_sigma, *addresses_of(blurred, noise, sensed)))
    return sensed


def _noisy_depth(depth: Float32, sensing: Sensing, chances: Noise) -> NDArray[np.uint16]:
    noise = _hanging_together(chances.standard_normal(depth.shape, dtype=np.float32), sensing.depth_noise_px)
    chance = chances.random(depth.shape, dtype=np.float32)
    around = np.ones((3, 3), np.uint8)
    lowest, highest = (np.asarray(of(depth, around), np.float32) for of in (cv2.erode, cv2.dilate))
    compiled = kernels()
    if compiled is None:
        is_edge = highest - lowest > np.float32(DEPTH_STEP) * np.maximum(depth, np.float32(SHORTEST_M))
        millimetres = 1000 * depth + np.float32(sensing.depth_sigma_at_1m_mm) * depth * depth * noise
        lost = chance < np.where(is_edge, np.float32(sensing.edge_dropout), np.float32(sensing.depth_dropout))
        lost |= (depth == 0) | (millimetres >= FARTHEST_MM)
        return np.where(lost, 0, np.maximum(millimetres + 0.5, 0)).astype(np.uint16)
    sensed = np.empty(depth.shape, np.uint16)
    request = DepthRequest(
        *(depth.size, sensing.depth_sigma_at_1m_mm, sensing.depth_dropout, sensing.edge_dropout),
        *(DEPTH_STEP, SHORTEST_M, FARTHEST_MM),
        *addresses_of(depth, lowest, highest, noise, chance, sensed),
    )
    compiled.run(request)
    return sensed


def _hanging_together(noise: Float32, sigma_px: float) -> Float32:
    """Noise [H, W] of deviation 1 that its neighbours share, as far as 1 sigma in pixels."""
    if sigma_px == 0:
        return noise
    reach = 2 * math.ceil(3 * sigma_px) + 1
    weights = cv2.getGaussianKernel(reach, sigma_px)
    shared = cv2.sepFilter2D(noise, -1, weights, weights, borderType=cv2.BORDER_REFLECT)
    return np.asarray(shared / np.float32((weights**2).sum()), np.float32)
