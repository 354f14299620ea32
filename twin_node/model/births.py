"""New Gaussians where the rendering does not explain the image, at the depth that the other views agree with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.model.observation import Observed, largest_channel
from twin_node.model.parameters import BirthParameters
from twin_node.model.rays import look
from twin_node.model.rendering import Rendering
from twin_node.scene import Bool, Float32, Float64

BLOCK = 2
"""Side in pixels of the block that one newborn stands for."""
SPREAD = 0.4
"""1 sigma of a newborn in sides of its block: smaller leaves gaps, larger smears over what is beside the block."""
SOLID = 0.5
"""Opacity of the background from which it can be learnt anew by colour alone; under it Gaussians are missing."""
COLOUR_SIGMA = 0.12
"""Difference of colour (0 to 1) at which another view half agrees: what one surface shows to two exposures."""
SAME_DEPTH = 0.02
"""Share of its depth by which a measured surface may lie before the background and still be it."""
HUGE_PX = 2.5
"""1 sigma in another view's pixels at which a newborn stands too close to that camera to be real."""
REFUTED = 10.0
"""What it costs a depth that a view sees through it: more than all other views can make good."""
LOCALITY = 0.3
"""What it costs to be e times as deep as the moving things already known around the pixel."""


@dataclass(frozen=True)
class Births:
    """Surface elements that explain blocks of pixels."""

    means: Float64
    """[n, 3] m, at the time of the view that needs them."""
    radii: Float64
    """[n] m, 1 sigma."""
    rgb: Float32
    """[n, 3] 0 to 1."""
    on_background: Bool
    """[n] whether it lies on what stands still: a shadow, a light, or ground that was uncovered."""
    lasting: Bool
    """[n] whether it fills a hole of the background: STATIC from birth."""
    views: NDArray[np.int64]
    """[n] which view needs it."""

    def __len__(self) -> int:
        return len(self.means)


@dataclass(frozen=True)
class _Pixels:
    """Blocks of one view that need explaining, worst first."""

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    rgb: Float32


def joined(parts: Sequence[Births]) -> Births:
    """Those of several views."""
    return Births(*(np.concatenate([vars(part)[name] for part in parts]) for name in vars(parts[0])))


def find_births_plainly(
    observed: Sequence[Observed],
    renderings: Sequence[Rendering],
    threshold: float,
    parameters: BirthParameters,
) -> Births:
    """Births for the pixels whose largest channel differs by more than `threshold` from `renderings`.

    In NumPy: the reference of `compiled_births.find_births`.
    """
    quota = parameters.per_set // max(len(observed), 1)
    parts = []
    for index, one in enumerate(observed):
        pixels = _unexplained(one, renderings[index], threshold, quota)
        parts.append(_lift(observed, renderings[index], index, pixels, parameters.ray_samples, threshold))
    return joined(parts)


def _unexplained(one: Observed, rendering: Rendering, threshold: float, quota: int) -> _Pixels:
    image = one.rgb
    counts = one.active & (one.surprise > 0.5 * threshold) & (~one.stale | (one.background.alpha < SOLID))
    at = np.nonzero(counts)
    error = np.zeros_like(one.surprise)
    error[at] = largest_channel(image[at], rendering.rgb.detach().cpu().numpy()[at])
    blocks = cv2.resize(error, (error.shape[1] // BLOCK, error.shape[0] // BLOCK), interpolation=cv2.INTER_AREA)
    colours = cv2.resize(image, (blocks.shape[1], blocks.shape[0]), interpolation=cv2.INTER_AREA)
    wrong = np.flatnonzero(blocks > threshold)
    order = wrong[np.argsort(-blocks.ravel()[wrong], kind="stable")[:quota]]
    rows, columns = np.unravel_index(order, blocks.shape)
    return _Pixels(rows * BLOCK, columns * BLOCK, colours[rows, columns].astype(np.float32))


def _lift(
    observed: Sequence[Observed], rendering: Rendering, index: int, pixels: _Pixels, samples: int, threshold: float
) -> Births:
    one = observed[index]
    camera = one.view.camera
    rows, columns = pixels.rows, pixels.columns
    far = one.background.depth[rows, columns]
    rays = (one.background.rays[rows, columns] + one.background.rays[rows + BLOCK - 1, columns + BLOCK - 1]) / 2
    if one.view.depth is not None:
        depth, on_background = _measured(one, rows, columns, far)
    else:
        depth, on_background = _agreed(observed, rendering, index, pixels, rays, far, samples)
    means = camera.T_base_cam[:3, 3] + rays * depth[:, None]
    radii = SPREAD * BLOCK * depth / camera.K[0, 0]
    lasting = on_background & (one.background.alpha[rows, columns] < SOLID)
    kept = ~(on_background & ~lasting & _contradicted(observed, index, means, threshold))
    return Births(
        means[kept], radii[kept], pixels.rgb[kept], on_background[kept], lasting[kept], np.full(int(kept.sum()), index)
    )


def _contradicted(observed: Sequence[Observed], index: int, means: Float64, threshold: float) -> Bool:
    """[n] points on the background at which another view shows the background unchanged."""
    out = np.zeros(len(means), bool)
    for other_index, other in enumerate(observed):
        if other_index != index:
            seen = look(other.view.camera, means)
            visible = seen.inside & ~other.background.occluded(seen) & other.usable[seen.rows, seen.columns]
            out |= visible & (other.surprise[seen.rows, seen.columns] < 0.5 * threshold)
    return out


def _measured(one: Observed, rows: NDArray[np.int64], columns: NDArray[np.int64], far: Float64) -> tuple[Float64, Bool]:
    assert one.view.depth is not None
    depth = one.view.depth[rows, columns].astype(np.float64)
    depth = np.where(depth > 0, depth, far)
    return depth, depth > (1 - SAME_DEPTH) * far


def _agreed(
    observed: Sequence[Observed],
    rendering: Rendering,
    index: int,
    pixels: _Pixels,
    rays: Float64,
    far: Float64,
    samples: int,
) -> tuple[Float64, Bool]:
    """Depth [n] along the rays with the best support of other views; the background's where none is left standing."""
    one = observed[index]
    shares = np.linspace(0.15, 0.97, samples)
    depths = far[:, None] * shares
    points = (one.view.camera.T_base_cam[:3, 3] + rays[:, None] * depths[..., None]).reshape(-1, 3)
    score = np.zeros(len(points))
    for other_index, other in enumerate(observed):
        if other_index != index:
            radii = (0.5 * BLOCK / one.view.camera.K[0, 0] * depths).ravel()
            score += _support(other, points, radii, np.repeat(pixels.rgb, samples, axis=0))
    score = score.reshape(depths.shape) - LOCALITY * np.abs(
        np.log(depths / _known_depth(one, rendering, pixels, far)[:, None])
    )
    best = score.argmax(1)
    at = np.arange(len(best))
    alone = score[at, best] < -0.5 * REFUTED
    off = ~one.near_moving[pixels.rows, pixels.columns]
    on_background = alone | off
    return np.where(on_background, 0.995 * far, depths[at, best]), on_background


def _support(other: Observed, points: Float64, radii: Float64, rgb: Float32) -> Float64:
    """[n] how much one view speaks for each point: 0 where it cannot see it, against what would fill much of it."""
    seen = look(other.view.camera, points)
    visible = seen.inside & ~other.background.occluded(seen) & other.usable[seen.rows, seen.columns]
    moving = other.near_moving[seen.rows, seen.columns]
    difference = np.abs(other.rgb[seen.rows, seen.columns] - rgb).mean(-1)
    agreement = 0.5 + np.exp(-((difference / COLOUR_SIGMA) ** 2))
    huge = (seen.depth > -radii) & (radii * other.view.camera.K[0, 0] > HUGE_PX * np.maximum(seen.depth, 0.02))
    return np.where(huge | (visible & ~moving), -REFUTED, np.where(visible, agreement, 0.0))


def _known_depth(one: Observed, rendering: Rendering, pixels: _Pixels, far: Float64) -> Float64:
    """[n] depth of the moving things that the rendering shows around each pixel, the ground's where it shows none."""
    shown = rendering.depth.detach().cpu().numpy()
    closer = (shown > 0) & (shown < 0.95 * one.background.depth)
    if not closer.any():
        return 0.9 * far
    cells = 8
    height, width = shown.shape
    row_cell, column_cell = (
        np.minimum(pixels.rows * cells // height, cells - 1),
        np.minimum(pixels.columns * cells // width, cells - 1),
    )
    rows, columns = np.nonzero(closer)
    depths = shown[rows, columns]
    labels = rows * cells // height * cells + columns * cells // width
    total = np.bincount(labels, weights=depths, minlength=cells * cells)
    count = np.bincount(labels, minlength=cells * cells)
    mean = np.where(count > 0, total / np.maximum(count, 1), float(np.median(depths)))
    known: Float64 = np.minimum(mean[row_cell * cells + column_cell], far)
    return known
