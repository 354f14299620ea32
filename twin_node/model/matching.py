"""How well the points along one view's rays look alike in another view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.model.kernel_requests import CompareRequest
from twin_node.model.kernels import kernels
from twin_node.model.rays import look
from twin_node.native_library import addresses_of, thread_count
from twin_node.scene import Bool, Camera, Float32, Float64

COLOUR_SIGMA = 0.06
"""1 sigma of a surface's colour (0 to 1, mean over channels) between two views: gloss and exposure."""
OUTLIERS = 0.05
"""Density of colours that have nothing to do with the surface, beside the 1 of a perfect match."""


@dataclass(frozen=True)
class Sight:
    """A view as it is matched."""

    camera: Camera
    rgb: Float32
    """[H, W, 3] 0 to 1, smoothed by about a pixel."""
    valid: Bool
    """[H, W] pixels that show something."""
    rays: Float64
    """[H, W, 3], see `pixel_rays`."""
    base: Float64
    """[H, W] m: depth of the dominant plane, or of the shell where that is before it."""


@dataclass(frozen=True)
class Match:
    """One view's points, K along each ray, in another view."""

    other: int
    """Number of the other view."""
    costs: Float32
    """[H, W, K] log-likelihood of the other's colour there if the point were no surface, less that if it were one; 0
    where the other view does not see it."""
    pixels: NDArray[np.int32]
    """[H, W, K] the other's pixel, row-major; -1 where it does not see the point."""
    near: Float32
    """[H, W] m: depth in the other view of a point at the first one's centre."""
    slope: Float32
    """[H, W] m: how much deeper it lies there at `Sight.base`."""


def match(one: Sight, other: Sight, number: int, shares: Float64) -> Match:
    """Points of `one` at `shares` [K] of its base depth, as the view `other`, the `number`th, sees them.

    What a colour tells is held against the other colours along the same ray: where all are alike none tells anything.
    """
    centre, reach = one.camera.T_base_cam[:3, 3], one.rays * one.base[..., None]
    apart, pixels = compared(one, other, reach, shares)
    seen = pixels >= 0
    alike = np.exp(-0.5 * (apart / COLOUR_SIGMA) ** 2) + np.float32(OUTLIERS)
    likelihoods = np.where(seen, alike, np.float32(0))
    usual = likelihoods.sum(-1) / np.maximum(seen.sum(-1), 1)
    costs = np.zeros(seen.shape, np.float32)
    np.divide(usual[..., None], likelihoods, out=costs, where=seen)
    np.log(costs, out=costs, where=seen)
    axis, offset = other.camera.viewmat[2, :3], other.camera.viewmat[2, 3]
    near = np.full(one.base.shape, axis @ centre + offset, np.float32)
    return Match(number, costs, pixels, near, (reach @ axis).astype(np.float32))


def compared(one: Sight, other: Sight, reach: Float64, shares: Float64) -> tuple[Float32, NDArray[np.int32]]:
    """[H, W, K] by how much colours differ, mean over channels, and pixels of `other`, -1 where it does not see them.

    Of the points at `shares` [K] of `reach` [H, W, 3] m from the centre of `one`.
    """
    compiled = kernels()
    if compiled is None:
        return compared_reference(one, other, reach, shares)
    shape, camera = (*one.base.shape, len(shares)), other.camera
    apart, at = np.empty(shape, np.float32), np.empty(shape, np.int32)
    doubles = [
        np.ascontiguousarray(array, np.float64)
        for array in (one.camera.T_base_cam[:3, 3], reach, shares, camera.viewmat, camera.K)
    ]
    colours = [np.ascontiguousarray(rgb, np.float32) for rgb in (one.rgb, other.rgb)]
    valid = np.ascontiguousarray(other.valid)
    given = addresses_of(*doubles, *colours, valid, apart, at)
    compiled.run(CompareRequest(one.base.size, len(shares), camera.width, camera.height, thread_count(), *given))
    return apart, at


def compared_reference(one: Sight, other: Sight, reach: Float64, shares: Float64) -> tuple[Float32, NDArray[np.int32]]:
    """`compared` in NumPy."""
    shape = (*one.base.shape, len(shares))
    apart, at = np.empty(shape, np.float32), np.empty(shape, np.int32)
    for k, share in enumerate(shares):
        seen = look(other.camera, (one.camera.T_base_cam[:3, 3] + reach * share).reshape(-1, 3))
        differences = np.abs(other.rgb[seen.rows, seen.columns] - one.rgb.reshape(-1, 3)).mean(-1)
        counts = seen.inside & other.valid[seen.rows, seen.columns]
        pixels = np.where(counts, seen.rows * other.camera.width + seen.columns, -1)
        apart[..., k], at[..., k] = differences.reshape(shape[:2]), pixels.reshape(shape[:2])
    return apart, at
