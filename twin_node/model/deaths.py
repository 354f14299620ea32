"""Which Gaussians the images refute: moving ones that a camera sees through, static ones that are no longer there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from twin_node.model.backgrounds import OCCLUSION, on_surface, pixels_reached
from twin_node.model.observation import Observed
from twin_node.model.quality import MOVING_THRESHOLD
from twin_node.model.rays import Seen, look
from twin_node.model.rendering import Rendering
from twin_node.scene import Bool, Float32, Float64

SEEN_THROUGH = 0.05
"""Share of its depth by which a measured surface must lie behind a Gaussian to refute it."""

REACH = 2.2
"""Sigmas from its centre at which a tenth of a Gaussian is left."""

CLASH = 0.2
"""Difference of a channel (0 to 1) between a Gaussian and the image behind it that no blur of their edge explains."""


@dataclass(frozen=True)
class Shapes:
    """n Gaussians where one view sees them, at its time."""

    means: Float32
    """[n, 3] m."""
    radii: Float64
    """[n] m, 1 sigma, mean over the axes."""


def refuted_moving_reference(observed: Sequence[Observed], shapes: Sequence[Shapes], carried: Bool) -> Bool:
    """[n] moving Gaussians that some view sees through.

    `shapes` holds them for each view. `carried` [n] says which have a node: a view that shows nothing moving where
    their centres are speaks against them; against others, one that shows the background. That holds at the image's edge
    too, for what reaches in from beyond. Rims that hang over are for the fit to mend: what was taken away for that was
    born again, as a guess. In NumPy: the reference of `compiled_deaths.refuted_moving`.
    """
    refuted = np.zeros(len(carried), bool)
    for one, shape in zip(observed, shapes, strict=True):
        seen = look(one.view.camera, shape.means)
        at = seen.rows * one.usable.shape[1] + seen.columns
        looms = pixels_reached(one.view.camera, seen, shape.means, REACH * shape.radii) > 1
        behind = seen.depth > (one.background.depth * (1 + OCCLUSION)).take(at)
        empty = one.usable.take(at) & ~np.where(carried, one.near_moving.take(at), one.active.take(at))
        refuted |= (seen.inside | looms) & ~behind & empty
        refuted |= seen_through(one, seen)
    return refuted


def are_needed(observed: Sequence[Observed], shapes: Sequence[Shapes]) -> Bool:
    """[n] which Gaussians lie where a view measures depth of what its background does not explain.

    Those that some view sees through do not. `shapes` holds them for each view. Of their place nothing is guessed
    there: without them there were a hole until others are born.
    """
    needed, refuted = (np.zeros(len(shapes[0].means), bool) for _ in range(2))
    for one, shape in zip(observed, shapes, strict=True):
        if one.nearest is not None:
            seen = look(one.view.camera, shape.means)
            apart = np.abs(one.nearest[seen.rows, seen.columns] - seen.depth)
            needed |= seen.inside & seen.within(one.surprise > MOVING_THRESHOLD) & (apart < SEEN_THROUGH * seen.depth)
            refuted |= seen_through(one, seen)
    return needed & ~refuted


def lie_still(observed: Sequence[Observed], shapes: Sequence[Shapes]) -> Bool:
    """[n] which Gaussians lie where no view shows anything that moves. `shapes` holds them for each view."""
    still = np.ones(len(shapes[0].means), bool)
    for one, shape in zip(observed, shapes, strict=True):
        seen = look(one.view.camera, shape.means)
        still &= ~(seen.inside & seen.within(one.near_moving))
    return still


@dataclass(frozen=True)
class StaticEvidence:
    """What a set says about the STATIC Gaussians."""

    left: Bool
    """[n] every view that should show them shows something else, or one measures depth behind them."""
    moving: Bool
    """[n] every view that should show them shows something that moves there, and two views or more do."""


def judge_static_reference(observed: Sequence[Observed], renderings: Sequence[Rendering]) -> StaticEvidence:
    """Which STATIC Gaussians have left their place, and which are part of something that moves.

    `renderings` is what the whole model looks like: what stands behind something moving is covered, not gone. What lies
    on the plane or the shell moves never, whatever it looks like, and leaves only by measured depth. In NumPy: the
    reference of `compiled_deaths.judge_static`.
    """
    count = len(observed[0].background.static.rows)
    shown, gone, moving = (np.zeros(count, np.int64) for _ in range(3))
    proven = np.zeros(count, bool)
    for one, rendering in zip(observed, renderings, strict=True):
        seen = one.background.static
        visible = are_visible(one, rendering, seen)
        changed = one.surprise[seen.rows, seen.columns] > MOVING_THRESHOLD
        if one.nearest is not None:
            visible &= one.nearest[seen.rows, seen.columns] > (1 - SEEN_THROUGH) * seen.depth
            changed = np.zeros(count, bool)
        proven |= seen_through(one, seen)  # through all that is drawn before it too
        shown += visible
        gone += visible & changed
        moving += visible & one.moving[seen.rows, seen.columns]
    off = ~on_surface([one.background for one in observed])
    left = proven | (off & (gone == shown) & (gone >= 1))
    return StaticEvidence(left, off & (moving == shown) & (moving >= min(2, len(observed))))


def are_visible(one: Observed, rendering: Rendering, seen: Seen) -> Bool:
    """[n] points that a view shows: nothing STATIC stands before them, nor what moves as `rendering` has it."""
    at = (seen.rows, seen.columns)
    front = rendering.pixels[..., 3][at]
    covered = one.active[at] & (front > 0) & (seen.depth > (1 + OCCLUSION) * front)
    return np.asarray(seen.inside & ~one.background.occluded(seen) & ~covered & one.usable[at])


def clashing(observed: Sequence[Observed], left: Bool, rgb: Tensor) -> Bool:
    """[n] which of the STATIC Gaussians that have `left` [n], of colours `rgb` [n, 3], need no second look.

    Some view measures depth behind them and shows another colour there: both at once are no noise, and what waits for
    another look is a speck on what was uncovered.
    """
    clash, suspects = np.zeros_like(left), left.nonzero()[0]
    if not len(suspects):
        return clash
    colours = rgb[torch.from_numpy(suspects).to(rgb.device)].cpu().numpy()
    for one in observed:
        seen = one.background.static.of(suspects)
        differs = np.abs(one.rgb[seen.rows, seen.columns] - colours).max(-1) > CLASH
        clash[suspects] |= seen_through(one, seen) & differs
    return clash


def seen_through(one: Observed, seen: Seen) -> Bool:
    """[n] points behind which the view measures depth."""
    if one.nearest is None:
        return np.zeros(len(seen.rows), bool)
    through: Bool = seen.inside & one.active[seen.rows, seen.columns]
    return through & (one.nearest[seen.rows, seen.columns] > (1 + SEEN_THROUGH) * seen.depth)
