"""New Gaussians where the rendering does not explain the image, at the depth that the other views agree with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.model.birth_depths import BLOCK, Depths, Pixels, agreed
from twin_node.model.observation import Observed
from twin_node.model.quality import MOVING_THRESHOLD, largest_channel
from twin_node.model.rays import look
from twin_node.model.rendering import Rendering
from twin_node.scene import Bool, Float32, Float64

SPREAD = 0.4
"""1 sigma of a newborn in sides of its block: smaller leaves gaps, larger smears over what is beside the block."""
SOLID = 0.5
"""Opacity of the background from which it can be learnt anew by colour alone; under it Gaussians are missing."""
SAME_DEPTH = 0.02
"""Share of its depth by which a measured surface may lie before the background and still be it."""
ALIKE = 0.25
"""Largest difference of a channel (0 to 1) within a block that is larger than the smallest: finer detail is kept."""
BUSY = 1 / 8
"""Share of all pixels that moves where much does: what newborns must be able to cover."""


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


def joined(parts: Sequence[Births]) -> Births:
    """Those of several views."""
    return Births(*(np.concatenate([vars(part)[name] for part in parts]) for name in vars(parts[0])))


def block_side(pixels: int, room: int) -> int:
    """Side in pixels, a multiple of `BLOCK`, of blocks of which about `room` cover what moves of `pixels` in all.

    Larger images have more pixels than there is room for: as many small blocks would leave gaps between them for good.
    """
    return BLOCK * max(1, round(math.sqrt(BUSY * pixels / max(room, 1)) / BLOCK))


def find_births_reference(
    observed: Sequence[Observed],
    renderings: Sequence[Rendering],
    most: int,
    side: int = BLOCK,
) -> Births:
    """Births, `most` of them, for pixels whose largest channel differs by `MOVING_THRESHOLD` from `renderings`.

    One stands for a block of `BLOCK` pixels squared, or of `side` where all of that is wrong and looks alike. In NumPy:
    the reference of `compiled_births.find_births`.
    """
    quota = most // max(len(observed), 1)
    parts = []
    for index, one in enumerate(observed):
        pixels = _unexplained(one, renderings[index], quota, side)
        parts.append(_lift(observed, renderings[index], index, pixels))
    return joined(parts)


def _unexplained(one: Observed, rendering: Rendering, quota: int, side: int) -> Pixels:
    image = one.rgb
    counts = one.active & (one.surprise > 0.5 * MOVING_THRESHOLD) & (~one.stale | (one.background.alpha < SOLID))
    at = np.nonzero(counts)
    error = np.zeros_like(one.surprise)
    error[at] = largest_channel(image[at], rendering.pixels[..., :3][at])
    errors, colours = block_means(error, BLOCK), block_means(image, BLOCK)
    wrong = errors > MOVING_THRESHOLD
    times = side // BLOCK
    large = _united(wrong, colours, times) if times > 1 else np.zeros_like(wrong[:0, :0])
    of_large = np.zeros_like(wrong)
    of_large[: times * len(large), : times * large.shape[1]] = large.repeat(times, 0).repeat(times, 1)
    found = (np.nonzero(large), np.nonzero(wrong & ~of_large))
    sides = np.repeat([side, BLOCK], [len(rows) for rows, _ in found])
    rows, columns = (np.concatenate(at) * sides for at in zip(*found, strict=True))
    sums = np.concatenate([side**2 * block_means(error, side)[found[0]], BLOCK**2 * errors[found[1]]])
    rgb = np.concatenate([block_means(image, side)[found[0]], colours[found[1]]])
    worst = np.argsort(-sums, kind="stable")[:quota]
    middle = sides // 2 - 1
    return Pixels((rows + middle)[worst], (columns + middle)[worst], rgb[worst], sides[worst])


def _united(wrong: Bool, colours: Float32, times: int) -> Bool:
    """[H // times, W // times] squares of `times` blocks each way that are all `wrong` [H, W] and look alike."""
    rows, columns = (of // times for of in wrong.shape)
    squares = (rows, times, columns, times)
    whole = wrong[: rows * times, : columns * times].reshape(squares).all((1, 3))
    looks = colours[: rows * times, : columns * times].reshape(*squares, 3)
    alike: Bool = (np.ptp(looks, (1, 3)) <= ALIKE).all(-1)
    return whole & alike


def block_means(image: Float32, side: int) -> Float32:
    """[H // side, W // side, ...] means of the whole blocks of `side` pixels squared of an image [H, W, ...]."""
    rows, columns = (of // side for of in image.shape[:2])
    if not rows * columns:
        return np.zeros((rows, columns, *image.shape[2:]), np.float32)
    whole = image[: rows * side, : columns * side]
    return cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float32)


def _lift(observed: Sequence[Observed], rendering: Rendering, index: int, pixels: Pixels) -> Births:
    one = observed[index]
    camera = one.view.camera
    rows, columns = pixels.rows, pixels.columns
    far = one.background.depth[rows, columns]
    rays = (one.background.rays[rows, columns] + one.background.rays[rows + 1, columns + 1]) / 2
    if one.view.depth is not None:
        lying = _measured(one, rows, columns, far)
    else:
        lying = agreed(observed, rendering, index, pixels, rays)
    depth, on_background = lying.depths, lying.on_background
    means = camera.T_base_cam[:3, 3] + rays * depth[:, None]
    radii = SPREAD * pixels.sides * depth / camera.K[0, 0]
    lasting = on_background & (one.background.alpha[rows, columns] < SOLID)
    kept = ~(on_background & ~lasting & _contradicted(observed, index, means))
    return Births(
        means[kept], radii[kept], pixels.rgb[kept], on_background[kept], lasting[kept], np.full(int(kept.sum()), index)
    )


def _contradicted(observed: Sequence[Observed], index: int, means: Float64) -> Bool:
    """[n] points on the background at which another view shows the background unchanged."""
    out = np.zeros(len(means), bool)
    for other_index, other in enumerate(observed):
        if other_index != index:
            seen = look(other.view.camera, means)
            visible = seen.inside & ~other.background.occluded(seen) & other.usable[seen.rows, seen.columns]
            out |= visible & (other.surprise[seen.rows, seen.columns] < 0.5 * MOVING_THRESHOLD)
    return out


def _measured(one: Observed, rows: NDArray[np.int64], columns: NDArray[np.int64], far: Float64) -> Depths:
    assert one.view.depth is not None
    depth = one.view.depth[rows, columns].astype(np.float64)
    depth = np.where(depth > 0, depth, far)
    return Depths(depth, depth > (1 - SAME_DEPTH) * far)
