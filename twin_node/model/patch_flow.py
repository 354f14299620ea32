"""Dense inverse search (Kroeger et al., 2016) of the patches near what moves alone, in NumPy: what is compiled is this.

From coarse to fine, each patch of the rendering is moved to where the image looks like it, brightness left aside. It
begins where its own or a neighbour's motion so far fits best. A pixel goes as the patches that hold it do, those the
more that fit it better. Near what moves is a fifth of an image: OpenCV's search, of all around it, takes four times as
long.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.scene import Bool, Float32, UInt8

SIDE = 8
"""Of a patch, pixels; and the farthest that a search leads from where it began."""
STRIDE = 4
"""Pixels from one patch to the next: at 5 bodies in small images come apart more often."""
LEVELS = 3
"""Of the pyramids that are searched: motions of 8 pixels are 2 on the coarsest."""
WIDTH = 320
"""px: levels of twice this width or more are not searched. A tenth of a pixel of the next is as much of the scene, and
things are found twice as far."""
PASSES, STEPS = 2, 6
"""Times that patches look at their neighbours, and steps after each."""
BORDER = 16
"""Pixels by which a patch may be moved out of the image."""
STIFFNESS = 16.0
"""Squared gradient (levels per pixel) of a patch that holds it where it is: less tells its motion worse than noise."""
GREY = np.array([0.299, 0.587, 0.114], np.float32)


def flow_between(shown: Float32, image: UInt8, wanted: Bool) -> Float32:
    """[H, W, 2] pixels from where `shown` [H, W, 3] (0 to 1) shows a thing to where `image` [H, W, 3] does.

    0 but for the patches that hold pixels which are `wanted` [H, W]. Where `shown` is no number it is black.
    """
    if not wanted.any() or min(wanted.shape) < SIDE:
        return np.zeros((*wanted.shape, 2), np.float32)
    whole = _Level((255 * np.where(shown > 0, shown, 0).clip(0, 1)) @ GREY, image.astype(np.float32) @ GREY, wanted)
    levels = [whole]
    skipped = unsearched(wanted.shape[1])
    while len(levels) < LEVELS + skipped and min(levels[-1].wanted.shape) >= 2 * SIDE:
        levels.append(levels[-1].halved())
    skipped = min(skipped, len(levels) - 1)
    flow = None
    for level in reversed(levels[skipped:]):
        flow = _searched(level, flow)
    assert flow is not None
    for level in reversed(levels[:skipped]):
        flow = _doubled(flow, *np.indices(level.wanted.shape))
    return flow


def unsearched(width: int) -> int:
    """How many of the finest levels of an image so wide are not searched."""
    return max(width // WIDTH, 1).bit_length() - 1


@dataclass(frozen=True)
class _Level:
    """One level of both images' pyramids."""

    shown: Float32
    """[H, W] grey levels."""
    image: Float32
    """[H, W]."""
    wanted: Bool
    """[H, W]."""

    def halved(self) -> _Level:
        """Half the size: means of 2 x 2 pixels; wanted is what holds a wanted one."""
        height, width = (side // 2 for side in self.wanted.shape)
        rows, columns = np.nonzero(self.wanted)
        wanted = np.zeros((height, width), bool)
        wanted[np.minimum(rows // 2, height - 1), np.minimum(columns // 2, width - 1)] = True
        return _Level(_halved(self.shown, height, width), _halved(self.image, height, width), wanted)


def _halved(image: Float32, height: int, width: int) -> Float32:
    half: Float32 = image[: 2 * height, : 2 * width].reshape(height, 2, width, 2).mean((1, 3))
    return half


class _Patches:
    """The n patches of a level that hold a wanted pixel, on their grid."""

    def __init__(self, level: _Level) -> None:
        self._shape = level.wanted.shape
        tops, lefts = (np.minimum(np.arange(0, s - SIDE + STRIDE, STRIDE), s - SIDE) for s in self._shape)
        holds = np.lib.stride_tricks.sliding_window_view(level.wanted, (SIDE, SIDE))[np.ix_(tops, lefts)].any((2, 3))
        self._grid = np.full(np.add(holds.shape, 2), -1)
        self._at = np.nonzero(holds)
        self._grid[1:-1, 1:-1][self._at] = np.arange(len(self._at[0]))
        self.tops, self.lefts = tops[self._at[0]], lefts[self._at[1]]
        self._shown = self.cut(level.shown)
        self._around = np.pad(level.image, BORDER, mode="edge")

    def __len__(self) -> int:
        return len(self.tops)

    def cut(self, image: Float32) -> Float32:
        """[n, 8, 8] of an image [H, W]."""
        windows = np.lib.stride_tricks.sliding_window_view(image, (SIDE, SIDE))
        return np.ascontiguousarray(windows[self.tops, self.lefts])

    def neighbours(self) -> list[NDArray[np.int64]]:
        """Four times [n]: who is to the left, to the right, above and below of each; -1 for nobody."""
        rows, columns = self._at[0] + 1, self._at[1] + 1
        return [self._grid[rows + down, columns + right] for down, right in ((0, -1), (0, 1), (-1, 0), (1, 0))]

    def differences(self, shifts: Float32, chosen: NDArray[np.int64]) -> Float32:
        """[k, 8, 8] what the image shows of the patches `chosen` [k], moved by `shifts` [k, 2], less the rendering."""
        x = _placed(self.lefts[chosen] + shifts[:, 0], self._shape[1])
        y = _placed(self.tops[chosen] + shifts[:, 1], self._shape[0])
        left, top = np.floor(x), np.floor(y)
        fx, fy = (x - left)[:, None, None], (y - top)[:, None, None]
        windows = np.lib.stride_tricks.sliding_window_view(self._around, (SIDE + 1, SIDE + 1))
        seen = windows[top.astype(np.int64) + BORDER, left.astype(np.int64) + BORDER]
        upper = (1 - fx) * (1 - fy) * seen[:, :-1, :-1] + fx * (1 - fy) * seen[:, :-1, 1:]
        lower = (1 - fx) * fy * seen[:, 1:, :-1] + fx * fy * seen[:, 1:, 1:]
        moved: Float32 = upper + lower - self._shown[chosen]
        return moved


def _placed(at: NDArray[np.floating], size: int) -> Float32:
    """Where patches may lie: as far outside as the rim is repeated."""
    placed: Float32 = np.clip(at, 1 - BORDER, size - SIDE + BORDER - 2).astype(np.float32)
    return placed


def _centred(patches: Float32) -> Float32:
    """[n, 8, 8] less the mean of each."""
    centred: Float32 = patches - patches.mean((1, 2), keepdims=True)
    return centred


def _searched(level: _Level, coarser: Float32 | None) -> Float32:
    """[H, W, 2] the flow of a level, from that of the `coarser` one on or from none."""
    patches, shape = _Patches(level), level.wanted.shape
    shifts = np.zeros((len(patches), 2), np.float32)
    if coarser is not None:
        shifts = _doubled(coarser, patches.tops + SIDE // 2, patches.lefts + SIDE // 2)
    rim = np.pad(level.shown, 1, mode="edge")
    sums, steps = rim[:-2] + 2 * rim[1:-1] + rim[2:], rim[2:] - rim[:-2]
    across = ((sums[:, 2:] - sums[:, :-2]) / 8).astype(np.float32)
    down = ((steps[:, :-2] + 2 * steps[:, 1:-1] + steps[:, 2:]) / 8).astype(np.float32)
    gradients = _centred(patches.cut(across)), _centred(patches.cut(down))
    for _ in range(PASSES):
        shifts = _descended(patches, gradients, _best_around(patches, shifts))
    return _spread(patches, shifts, shape)


def _doubled(coarser: Float32, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Float32:
    """[..., 2] the flow of pixels at `rows` and `columns` [...] by that of the level above theirs [H, W, 2]."""
    at = tuple(np.minimum(of // 2, side - 1) for of, side in zip((rows, columns), coarser.shape, strict=False))
    doubled: Float32 = 2 * coarser[at]
    return doubled


def _best_around(patches: _Patches, shifts: Float32) -> Float32:
    """[n, 2] the shift of each patch or of a neighbour that fits it best."""
    everyone = np.arange(len(patches))
    best, least = shifts.copy(), np.square(_centred(patches.differences(shifts, everyone))).sum((1, 2))
    for neighbours in patches.neighbours():
        asked = everyone[neighbours >= 0]
        proposed = shifts[neighbours[asked]]
        misfit = np.square(_centred(patches.differences(proposed, asked))).sum((1, 2))
        better = misfit < least[asked]
        least[asked[better]], best[asked[better]] = misfit[better], proposed[better]
    return best


def _descended(patches: _Patches, gradients: tuple[Float32, Float32], begun: Float32) -> Float32:
    """[n, 2] shifts after Gauss-Newton steps from `begun` [n, 2], as long as each fits better than the one before."""
    gx, gy = gradients
    xx, yy = (np.square(g).sum((1, 2)) + np.float32(STIFFNESS) for g in gradients)
    xy = (gx * gy).sum((1, 2))
    share = 1 / (xx * yy - xy * xy)
    shifts, best = begun.copy(), begun.copy()
    least: Float32 = np.full(len(patches), np.inf, np.float32)
    going = np.arange(len(patches))
    for _ in range(STEPS):
        apart = _centred(patches.differences(shifts[going], going))
        misfit = np.square(apart).sum((1, 2))
        better = misfit < least[going]
        going, apart = going[better], apart[better]
        least[going], best[going] = misfit[better], shifts[going]
        px, py = (gx[going] * apart).sum((1, 2)), (gy[going] * apart).sum((1, 2))
        shifts[going, 0] -= share[going] * (yy[going] * px - xy[going] * py)
        shifts[going, 1] -= share[going] * (xx[going] * py - xy[going] * px)
    lost = np.square(best - begun).sum(1) > SIDE * SIDE
    return np.where(lost[:, None], begun, best)


def _spread(patches: _Patches, shifts: Float32, shape: tuple[int, ...]) -> Float32:
    """[H, W, 2] the flow of every pixel: of all patches that hold it, of those the most that fit it best."""
    weights = 1 / np.maximum(1, np.abs(patches.differences(shifts, np.arange(len(patches)))))
    rows = patches.tops[:, None, None] + np.arange(SIDE)[:, None]
    columns = patches.lefts[:, None, None] + np.arange(SIDE)
    sums = np.zeros((*shape, 3), np.float32)
    said = np.stack([weights, weights * shifts[:, 0, None, None], weights * shifts[:, 1, None, None]], -1)
    np.add.at(sums, (rows, columns), said)
    held, flow = sums[..., :1] > 0, np.zeros((*shape, 2), np.float32)
    return np.divide(sums[..., 1:], sums[..., :1], out=flow, where=held)
