"""Which Gaussians the images refute: moving ones that a camera sees through, static ones that are no longer there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_node.geometry import rotation_from_quat
from twin_node.model.backgrounds import OCCLUSION, on_surface, pixels_reached
from twin_node.model.observation import Observed
from twin_node.model.rays import Seen, look
from twin_node.model.rendering import Rendering
from twin_node.scene import Bool, Camera, Float32, Float64

SEEN_THROUGH = 0.05
"""Share of its depth by which a measured surface must lie behind a Gaussian to refute it."""

REACH = 2.2
"""Sigmas from its centre at which a tenth of a Gaussian is left."""
RIM = REACH * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
"""Where a Gaussian is looked for, in sigmas along the axes of its ellipse in the image: its centre and its rim."""
NEAREST_M = 0.02
"""Depth under which nothing is in front of a camera, m."""


@dataclass(frozen=True)
class Shapes:
    """n Gaussians where one view sees them, at its time."""

    means: Float32
    """[n, 3] m."""
    quats: Float32
    """[n, 4] w, x, y, z."""
    scales: Float32
    """[n, 3] m."""

    @property
    def axes(self) -> Float64:
        """[3, 3, n] m, of 1 sigma: coordinates in `base_link` of the three axes of each."""
        return np.ascontiguousarray(np.moveaxis(rotation_from_quat(self.quats) * self.scales[:, None, :], 0, -1))

    @property
    def radii(self) -> Float64:
        """[n] m, 1 sigma, mean over the axes."""
        radii: Float64 = self.scales.astype(np.float64).mean(-1)
        return radii


def refuted_moving_plainly(observed: Sequence[Observed], shapes: Sequence[Shapes], carried: Bool) -> Bool:
    """[n] moving Gaussians that some view sees through.

    `shapes` holds them for each view. `carried` [n] says which have a node: a view that shows nothing moving where they
    reach speaks against them; against others, one that shows the background. That holds at the image's edge too, for
    what reaches in from beyond. In NumPy: the reference of `compiled_deaths.refuted_moving`.
    """
    refuted = np.zeros(len(carried), bool)
    for one, shape in zip(observed, shapes, strict=True):
        seen = look(one.view.camera, shape.means)
        surface = (one.background.depth * (1 + OCCLUSION)).ravel()
        empty = np.concatenate([one.usable & ~one.active, one.usable & ~one.near_moving]).ravel()
        own = surface.size * carried
        rim = _around(seen, _half_axes(one.view.camera, shape), one.usable.shape)
        at_rim = rim.rows * one.usable.shape[1] + rim.columns
        refuted |= (rim.inside & ~(seen.depth > surface.take(at_rim)) & empty.take(at_rim + own)).any(0)
        looms = ~seen.inside & (pixels_reached(one.view.camera, seen, shape.means, REACH * shape.radii) > 1)
        at_edge = seen.rows * one.usable.shape[1] + seen.columns
        refuted |= looms & ~(seen.depth > surface.take(at_edge)) & empty.take(at_edge + own)
        refuted |= _seen_through(one, seen)
    return refuted


def are_needed(observed: Sequence[Observed], shapes: Sequence[Shapes], threshold: float) -> Bool:
    """[n] which Gaussians lie where a view measures depth of what its background does not explain.

    Those that some view sees through do not. `shapes` holds them for each view. Of their place nothing is guessed
    there: without them there were a hole until others are born.
    """
    needed, refuted = (np.zeros(len(shapes[0].means), bool) for _ in range(2))
    for one, shape in zip(observed, shapes, strict=True):
        if one.nearest is not None:
            seen = look(one.view.camera, shape.means)
            apart = np.abs(one.nearest[seen.rows, seen.columns] - seen.depth)
            needed |= seen.inside & seen.within(one.surprise > threshold) & (apart < SEEN_THROUGH * seen.depth)
            refuted |= _seen_through(one, seen)
    return needed & ~refuted


def _half_axes(camera: Camera, shape: Shapes) -> Float64:
    """[2, 2, n] pixels: the long and the short half axis of 1 sigma, (u, v), of the ellipses that a camera sees."""
    R = camera.viewmat[:3, :3]
    x, y, z = R @ shape.means.T + camera.viewmat[:3, 3:]
    z = np.maximum(z, NEAREST_M)
    axes = (R @ shape.axes.reshape(3, -1)).reshape(shape.axes.shape)
    u, v = (camera.K[k, k] / z * (axes[k] - at / z * axes[2]) for k, at in ((0, x), (1, y)))
    uu, uv, vv = (u * u).sum(0), (u * v).sum(0), (v * v).sum(0)
    middle, apart = (uu + vv) / 2, np.hypot((uu - vv) / 2, uv)
    turn = np.arctan2(2 * uv, uu - vv) / 2
    way, across = np.stack([np.cos(turn), np.sin(turn)]), np.stack([-np.sin(turn), np.cos(turn)])
    return np.stack([np.sqrt(middle + apart) * way, np.sqrt(np.maximum(middle - apart, 0)) * across])


def _around(seen: Seen, half_axes: Float64, shape: tuple[int, ...]) -> Seen:
    """[5, n] the pixels at the middles and on the rims of what is seen, of `half_axes` [2, 2, n] px, at one depth."""
    offsets = (RIM @ half_axes.reshape(2, -1)).reshape(len(RIM), *half_axes.shape[1:])
    shifts = np.rint(np.clip(offsets, -1e6, 1e6)).astype(np.int64)
    columns, rows = seen.columns + shifts[:, 0], seen.rows + shifts[:, 1]
    inside = (columns >= 0) & (columns < shape[1]) & (rows >= 0) & (rows < shape[0])
    clipped = np.clip(columns, 0, shape[1] - 1), np.clip(rows, 0, shape[0] - 1)
    return Seen(*clipped, seen.depth, inside & seen.inside)


@dataclass(frozen=True)
class StaticEvidence:
    """What a set says about the STATIC Gaussians."""

    left: Bool
    """[n] every view that should show them shows something else, or one measures depth behind them."""
    moving: Bool
    """[n] every view that should show them shows something that moves there, and two views or more do."""


def judge_static_plainly(
    observed: Sequence[Observed], renderings: Sequence[Rendering], threshold: float
) -> StaticEvidence:
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
        front = rendering.depth.cpu().numpy()[seen.rows, seen.columns]
        covered = one.active[seen.rows, seen.columns] & (front > 0) & (seen.depth > (1 + OCCLUSION) * front)
        visible = seen.inside & ~one.background.occluded(seen) & ~covered & one.usable[seen.rows, seen.columns]
        changed = one.surprise[seen.rows, seen.columns] > threshold
        if one.nearest is not None:
            visible &= one.nearest[seen.rows, seen.columns] > (1 - SEEN_THROUGH) * seen.depth
            changed = np.zeros(count, bool)
        proven |= _seen_through(one, seen)  # through all that is drawn before it too
        shown += visible
        gone += visible & changed
        moving += visible & one.moving[seen.rows, seen.columns]
    off = ~on_surface([one.background for one in observed])
    left = proven | (off & (gone == shown) & (gone >= 1))
    return StaticEvidence(left, off & (moving == shown) & (moving >= min(2, len(observed))))


def _seen_through(one: Observed, seen: Seen) -> Bool:
    """[n] points behind which the view measures depth."""
    if one.nearest is None:
        return np.zeros(len(seen.rows), bool)
    through: Bool = seen.inside & one.active[seen.rows, seen.columns]
    return through & (one.nearest[seen.rows, seen.columns] > (1 + SEEN_THROUGH) * seen.depth)
