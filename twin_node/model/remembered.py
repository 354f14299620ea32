"""What a camera saw at rest, and how bright it shows that now: by the compiled kernels, else in NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from twin_node.model.kernel_requests import RatioRequest, RestRequest, SampledImage
from twin_node.model.kernels import kernels
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Exposure, Float32, UInt8

SAMPLES = 900
"""Pixels of an image that are looked at, on a grid: some hundreds tell six numbers well."""
FEWEST = 50
"""Of them that must be at rest to tell an exposure."""
UPTAKE = 0.05
"""Share of each levelled image that enters the memory."""
DARKEST = 0.06
"""Colours (0 to 1) under which a ratio tells noise."""
SLACK = 0.03
"""Error (0 to 1) of a pixel that is explained, at a gain of one: three sigma of a camera's noise in dim light."""
QUANTUM = np.float32(1 / 255)
"""An image's own steps; noise of two of them is there however dark it is."""
SATURATED = 250
"""Level from which on a pixel may have been brighter than it says."""


@dataclass(frozen=True)
class Ratios:
    """How bright an image shows what its camera saw at rest."""

    still: int
    """Samples that stand still."""
    middle: Float32 | None
    """[3] the middle ratio per colour to what was expected; None where too few samples tell one."""


class Remembered:
    """Images of one camera at rest, in the light of the model."""

    def __init__(self, rgb: UInt8) -> None:
        """Of the first image [H, W, 3], levelled."""
        self.shape = rgb.shape
        self.newest = np.ascontiguousarray(rgb).copy()
        """[H, W, 3] every pixel as it was when it stood still last."""
        self.stride = max(1, round(float(np.sqrt(rgb.shape[0] * rgb.shape[1] / SAMPLES))))
        """Pixels from one sample to the next."""
        self.samples: Float32 = np.ascontiguousarray(QUANTUM * rgb[:: self.stride, :: self.stride])
        """[h, w, 3] their mean of late, 0 to 1."""

    def ratios(self, rgb: UInt8, still: Bool, exposure: Exposure) -> Ratios:
        """How bright an image [H, W, 3] shows what stands `still` [H, W], beside what `exposure` makes of that."""
        library = kernels()
        if library is None:
            return self.ratios_reference(rgb, still, exposure)
        held = [np.ascontiguousarray(array) for array in (rgb, still)]
        given = [np.ascontiguousarray(array, np.float32) for array in (self.samples, exposure.gains, exposure.offsets)]
        found, middle = np.empty(2, np.int64), np.empty(3, np.float32)
        image = SampledImage(self.shape[1], self.shape[0], self.stride, *addresses_of(*held))
        library.run(RatioRequest(image, DARKEST, SATURATED * QUANTUM, *addresses_of(*given, found, middle)))
        return Ratios(int(found[0]), middle if found[1] >= FEWEST else None)

    def ratios_reference(self, rgb: UInt8, still: Bool, exposure: Exposure) -> Ratios:
        """The same in NumPy: the reference of the compiled kernel."""
        shown, seen = self.beside(rgb, still)
        return Ratios(len(shown), middle_ratios(exposure.of(shown), seen))

    def beside(self, rgb: UInt8, still: Bool) -> tuple[Float32, Float32]:
        """[n, 3] colours of the samples that stand `still` [H, W], and [n, 3] those that an image shows there."""
        chosen = still[:: self.stride, :: self.stride]
        return self.samples[chosen], (QUANTUM * rgb[:: self.stride, :: self.stride])[chosen]

    def take(self, rgb: UInt8, still: Bool) -> None:
        """Takes in an image [H, W, 3] that has been levelled."""
        library = kernels()
        if library is None:
            self.take_reference(rgb, still)
            return
        held = [np.ascontiguousarray(array) for array in (rgb, still)]
        image = SampledImage(self.shape[1], self.shape[0], self.stride, *addresses_of(*held))
        library.run(RestRequest(image, SLACK, UPTAKE, *addresses_of(self.newest, self.samples)))

    def take_reference(self, rgb: UInt8, still: Bool) -> None:
        """The same in NumPy: the reference of the compiled kernel."""
        cv2.copyTo(rgb, still.astype(np.uint8), self.newest)
        change = QUANTUM * rgb[:: self.stride, :: self.stride] - self.samples
        near = still[:: self.stride, :: self.stride] & (np.abs(change).max(-1) < SLACK)
        self.samples += np.where(near, np.float32(UPTAKE), np.float32(0))[..., None] * change


def middle_ratios(shown: Float32, seen: Float32) -> Float32 | None:
    """[3] the middle ratio of `seen` to `shown` [n, 3] per colour, where both tell one; None where too few do."""
    told = ((seen < SATURATED * QUANTUM) & (shown > DARKEST)).all(1)
    if np.count_nonzero(told) < FEWEST:
        return None
    ratios = (seen[told] / shown[told]).T
    half = ratios.shape[1] // 2
    middle: Float32 = np.partition(ratios, half, axis=-1)[:, half]
    return middle


def ratios_of_middles(shown: Float32, seen: Float32) -> Float32 | None:
    """[3] the ratio of the middle colours `seen` to those `shown` [n, 3]: dark ones tell so much together, not alone.

    None where too few are at hand, or nothing but black.
    """
    clear = (seen < SATURATED * QUANTUM).all(1)
    if np.count_nonzero(clear) < FEWEST:
        return None
    middles: Float32 = np.median([shown[clear], seen[clear]], axis=1).astype(np.float32)
    return None if (middles[0] < 2 * QUANTUM).any() else middles[1] / middles[0]
