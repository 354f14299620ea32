"""Depths of newborns where none is measured: where the other views agree, and neighbours that look alike do too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.model.observation import Observed
from twin_node.model.rays import look
from twin_node.model.rendering import Rendering
from twin_node.scene import Bool, Float32, Float64

SAMPLES = 24
"""Depths tried along the ray of a block."""
BLOCK = 2
"""Side in pixels of the block that one newborn stands for, where there is room for as many."""
COLOUR_SIGMA = 0.12
"""Difference of colour (0 to 1) at which another view half agrees: what one surface shows to two exposures."""
HUGE = 2.5
"""Times its block's size that a newborn has in another view where it stands too close to that camera to be real."""
REFUTED = 10.0
"""What it costs a depth that a view sees through it: more than all other views can make good."""
LOCALITY = 0.6
"""What it costs to be e times as deep as the moving things already known around the pixel."""
NEAREST, FARTHEST = 0.15, 0.97
"""Shares of the background's depth between which a newborn can lie."""
CLOSER, UNKNOWN = 0.95, 0.9
"""Share of the background's depth under which a rendering shows what moves, and the one that is guessed first."""
NEIGHBOUR_PX = 4.0
"""1 sigma of how far a pixel's neighbours count, pixels: two blocks; three blur small bodies."""
STRIDE, REACH = 2, 6
"""Every how many pixels the rendering is looked at around a pixel, and how many such steps each way: three sigmas."""
FEWEST = 0.25
"""Weight of the pixels around that must show something moving, or what moves anywhere else must do."""
DISSENT = -2.0
"""The least that a neighbour says of a depth: where it is seen through, a thing may end."""


@dataclass(frozen=True)
class Pixels:
    """n blocks of one view that need explaining, worst first."""

    rows: NDArray[np.int64]
    """[n] row of the pixel above and left of the middle."""
    columns: NDArray[np.int64]
    """[n] its column."""
    rgb: Float32
    """[n, 3] mean colour, 0 to 1."""
    sides: NDArray[np.int64]
    """[n] of each block, pixels: multiples of `BLOCK`."""


@dataclass(frozen=True)
class Depths:
    """Where n blocks lie."""

    depths: Float64
    """[n] m along the optical axis."""
    on_background: Bool
    """[n] nothing before the background is left standing."""


def agreed(observed: Sequence[Observed], rendering: Rendering, index: int, pixels: Pixels, rays: Float64) -> Depths:
    """Where blocks of view `index` lie along their `rays` [n, 3]: of `SAMPLES` depths those with the best support.

    What the other views say of a block counts for the blocks around that look like it too, at the same share of the
    background's depth: of one pixel an even surface tells little, and what each chose for itself fell apart. Where none
    of them looks at the depth that is chosen, the block lies in the middle of all that none looks at: an arm high over
    a table is seen by the camera above it alone, and near the depths known of other things it would hang before them.
    """
    one = observed[index]
    far = one.background.depth[pixels.rows, pixels.columns]
    levels = far[:, None] * np.linspace(NEAREST, FARTHEST, SAMPLES)
    votes = _votes(observed, index, pixels, rays, levels)
    weights = affinity(
        np.square(pixels.rows[:, None] - pixels.rows) + np.square(pixels.columns[:, None] - pixels.columns),
        pixels.rgb[:, None].astype(np.float64) - pixels.rgb,
    )
    shared = weights @ np.maximum(votes, DISSENT) / weights.sum(1, keepdims=True)
    known = known_depths(one, rendering, pixels, far)
    refuted = votes < -0.5 * REFUTED
    scores = np.where(refuted, votes, shared) - LOCALITY * np.abs(np.log(levels / known[:, None]))
    best = scores.argmax(1)
    at = (np.arange(len(scores)), best)
    alone = scores[at] < -0.5 * REFUTED
    on_background = alone | ~one.near_moving[pixels.rows, pixels.columns]
    if len(observed) > 1:
        at = (at[0], _settled(best, votes == 0))
    return Depths(np.where(on_background, 0.995 * far, levels[at]), on_background)


def _settled(best: NDArray[np.intp], unseen: Bool) -> NDArray[np.intp]:
    """[n] the `best` [n] of L levels; the middle of those that are `unseen` [n, L] where it is one of them."""
    passed = unseen.cumsum(1)
    middle = (passed >= (passed[:, -1:] + 1) // 2).argmax(1)
    return np.where(unseen[np.arange(len(best)), best], middle, best)


def affinity(square_px: NDArray[np.int64], differences: Float64) -> Float64:
    """[...] how much a pixel says of another, 0 to 1: of their squared distance and colours' differences [..., 3]."""
    unlike = np.square(differences).mean(-1) / COLOUR_SIGMA**2
    weights: Float64 = np.exp(-0.5 * (square_px / NEIGHBOUR_PX**2 + unlike))
    return weights


def known_depths(one: Observed, rendering: Rendering, pixels: Pixels, far: Float64) -> Float64:
    """[n] depth of the moving things that the rendering shows around each pixel and that look like it, m.

    The median of all that moves where none do; a guess before the background, `far` [n] m, where nothing does.
    """
    shown = rendering.pixels.astype(np.float64)
    rgb, depth = shown[..., :3], shown[..., 3]
    closer = (depth > 0) & (depth < CLOSER * one.background.depth)
    if not closer.any():
        return UNKNOWN * far
    known = np.full(len(far), np.median(depth[closer]))
    steps = STRIDE * np.arange(-REACH, REACH + 1)
    for i, (row, column) in enumerate(zip(pixels.rows, pixels.columns, strict=True)):
        rows = (row + steps)[(row + steps >= 0) & (row + steps < depth.shape[0])]
        columns = (column + steps)[(column + steps >= 0) & (column + steps < depth.shape[1])]
        at_row, at_column = (grid.ravel() for grid in np.meshgrid(rows, columns, indexing="ij"))
        own = closer[at_row, at_column]
        at = (at_row[own], at_column[own])
        weights = affinity(np.square(at[0] - row) + np.square(at[1] - column), rgb[at] - pixels.rgb[i])
        if weights.sum() >= FEWEST:
            order = np.argsort(depth[at], kind="stable")
            known[i] = depth[at][order][np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum())]
    return np.minimum(known, far)


def _votes(observed: Sequence[Observed], index: int, pixels: Pixels, rays: Float64, levels: Float64) -> Float64:
    """[n, L] how much the other views speak for blocks at each of their `levels` [n, L] m."""
    camera = observed[index].view.camera
    points = (camera.T_base_cam[:3, 3] + rays[:, None] * levels[..., None]).reshape(-1, 3)
    halves: Float64 = 0.5 * pixels.sides.astype(np.float64)
    radii = (halves[:, None] / camera.K[0, 0] * levels).ravel()
    rgb = np.repeat(pixels.rgb, levels.shape[1], axis=0)
    votes, huge_px = np.zeros(len(points)), HUGE * halves.repeat(levels.shape[1])
    for other_index, other in enumerate(observed):
        if other_index != index:
            votes += _support(other, points, radii, rgb, huge_px)
    return votes.reshape(levels.shape)


def _support(other: Observed, points: Float64, radii: Float64, rgb: Float32, huge_px: Float64) -> Float64:
    """[n] how much one view speaks for each point: 0 where it cannot see it, against what is larger than `huge_px`."""
    seen = look(other.view.camera, points)
    visible = seen.inside & ~other.background.occluded(seen) & other.usable[seen.rows, seen.columns]
    moving = other.near_moving[seen.rows, seen.columns]
    difference = np.abs(other.rgb[seen.rows, seen.columns] - rgb).mean(-1)
    agreement = 0.5 + np.exp(-((difference / COLOUR_SIGMA) ** 2))
    huge = (seen.depth > -radii) & (radii * other.view.camera.K[0, 0] > huge_px * np.maximum(seen.depth, 0.02))
    return np.where(huge | (visible & ~moving), -REFUTED, np.where(visible, agreement, 0.0))
