"""Semi-global matching (Hirschmüller 2008): labels that are cheap for their pixels and alike among neighbours."""

from __future__ import annotations

import numpy as np

from twin_node.model.kernel_requests import SmoothRequest
from twin_node.model.kernels import Kernels, kernels
from twin_node.native_library import address_of, thread_count
from twin_node.scene import Float32

STEP_COST, JUMP_COST = 0.25, 1.5
"""What neighbours of one colour cost that differ by one label, and by more. Costs are log-likelihoods: a jump must be
4.5 times as likely as none."""
EDGE = 0.08
"""Difference of colour (0 to 1) of neighbours at which a jump costs half as much: surfaces end where colours do."""


def smoothed(costs: Float32, image: Float32) -> Float32:
    """[H, W, K] costs of K labels in order, each with the least that neighbours on eight paths across the image add.

    `costs` [H, W, K] of the pixels by themselves, `image` [H, W, 3] 0 to 1. The best label of a pixel is that of the
    least.
    """
    compiled = kernels()
    return smoothed_reference(costs, image) if compiled is None else _smoothed_compiled(compiled, costs, image)


def _smoothed_compiled(compiled: Kernels, costs: Float32, image: Float32) -> Float32:
    costs, image = (np.ascontiguousarray(field, np.float32) for field in (costs, image))
    pairs, out = np.empty((4, *costs.shape), np.float32), np.empty_like(costs)
    given = (address_of(field) for field in (costs, image, pairs, out))
    compiled.run(SmoothRequest(*costs.shape, thread_count(), STEP_COST, JUMP_COST, EDGE, *given))
    return out


def smoothed_reference(costs: Float32, image: Float32) -> Float32:
    """`smoothed` in NumPy."""
    upright = np.ascontiguousarray(costs.transpose(1, 0, 2)), np.ascontiguousarray(image.transpose(1, 0, 2))
    total = _both_ways(costs, image) + _both_ways(*upright).transpose(1, 0, 2)
    for falling in (True, False):
        total += _unsheared(
            _both_ways(_sheared(costs, falling, 0.0), _sheared(image, falling, None)), total.shape, falling
        )
    return total


def _both_ways(costs: Float32, image: Float32) -> Float32:
    """Paths down the first axis and up again."""
    return _along(costs, image) + _along(costs[::-1], image[::-1])[::-1]


def _along(costs: Float32, image: Float32) -> Float32:
    """The recursion of the paper's equation 13, down the first axis."""
    out = np.empty_like(costs)
    out[0] = before = costs[0]
    jumps = np.maximum(JUMP_COST / (1 + np.abs(np.diff(image, axis=0)).max(-1) / EDGE), STEP_COST).astype(np.float32)
    for line in range(1, len(costs)):
        least = before.min(1, keepdims=True)
        best = np.minimum(before, least + jumps[line - 1, :, None])
        np.minimum(best[:, 1:], before[:, :-1] + np.float32(STEP_COST), out=best[:, 1:])
        np.minimum(best[:, :-1], before[:, 1:] + np.float32(STEP_COST), out=best[:, :-1])
        before = out[line] = costs[line] + best - least
    return out


def _sheared(field: Float32, falling: bool, beyond: float | None) -> Float32:
    """[H, W + H, ...] each row one pixel on from the one before, so that a diagonal is a column.

    Beyond the image lies `beyond`, or the row's own ends.
    """
    height, width = field.shape[:2]
    out = np.full((height, width + height, *field.shape[2:]), beyond or 0.0, np.float32)
    for row in range(height):
        start = row if falling else height - 1 - row
        out[row, start : start + width] = field[row]
        if beyond is None:
            out[row, :start], out[row, start + width :] = field[row, 0], field[row, -1]
    return out


def _unsheared(field: Float32, shape: tuple[int, ...], falling: bool) -> Float32:
    """What `_sheared` has made of [H, W, ...], back."""
    height, width = shape[:2]
    starts = np.arange(height) if falling else np.arange(height)[::-1]
    return np.stack([field[row, start : start + width] for row, start in enumerate(starts)])
