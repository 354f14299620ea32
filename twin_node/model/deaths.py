"""Which Gaussians the images refute: moving ones that a camera sees through, static ones that are no longer there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin_node.model.backgrounds import OCCLUSION, grow
from twin_node.model.observation import Observed
from twin_node.model.rays import look
from twin_node.model.rendering import Rendering
from twin_node.scene import Bool, Float64

SEEN_THROUGH = 0.05
"""Share of its depth by which a measured surface must lie behind a Gaussian to refute it."""

RIM = np.array([[0.0, 0.0], [2.2, 0.0], [-2.2, 0.0], [0.0, 2.2], [0.0, -2.2]])
"""Where a Gaussian is looked for, in sigmas along the image's axes: its centre and the rim where a tenth is left."""


def refuted_moving(observed: Sequence[Observed], means: Sequence[Float64], radii: Float64, carried: Bool) -> Bool:
    """[n] moving Gaussians that some view sees through.

    `means` holds [n, 3] per view, at its time; `radii` [n] 1 sigma in m. `carried` [n] says which have a node: a view
    that shows nothing moving where they reach speaks against them; against others, one that shows the background.
    """
    refuted = np.zeros(len(carried), bool)
    for one, at in zip(observed, means, strict=True):
        axes = one.view.camera.T_base_cam[:3, :2].T
        for share in RIM:
            seen = look(one.view.camera, at + radii[:, None] * (share @ axes))
            visible = seen.inside & ~one.background.occluded(seen) & one.usable[seen.rows, seen.columns]
            held = np.where(carried, one.near_moving[seen.rows, seen.columns], one.active[seen.rows, seen.columns])
            refuted |= visible & ~held
        if one.view.depth is not None:
            seen = look(one.view.camera, at)
            surface = one.view.depth[seen.rows, seen.columns]
            refuted |= seen.inside & one.usable[seen.rows, seen.columns] & (surface > (1 + SEEN_THROUGH) * seen.depth)
    return refuted


def refuted_static(observed: Sequence[Observed], renderings: Sequence[Rendering], threshold: float) -> Bool:
    """[n] STATIC Gaussians that have left: every view that should show them shows something else.

    `renderings` is what the whole model looks like: what stands behind something moving is covered, not gone. Where a
    camera measures depth, only depth behind a Gaussian speaks against it.
    """
    count = len(observed[0].background.static.rows)
    shown = np.zeros(count, np.int64)
    gone = np.zeros(count, np.int64)
    for one, rendering in zip(observed, renderings, strict=True):
        seen = one.background.static
        front = rendering.depth.cpu().numpy()[seen.rows, seen.columns]
        covered = one.active[seen.rows, seen.columns] & (front > 0) & (seen.depth > (1 + OCCLUSION) * front)
        visible = seen.inside & ~one.background.occluded(seen) & ~covered & one.usable[seen.rows, seen.columns]
        changed = one.surprise[seen.rows, seen.columns] > threshold
        if one.view.depth is not None:
            surface = one.view.depth[seen.rows, seen.columns]
            visible &= surface > (1 - SEEN_THROUGH) * seen.depth
            changed = surface > (1 + SEEN_THROUGH) * seen.depth
        shown += visible
        gone += visible & changed
    left: Bool = (gone == shown) & (gone >= 1)
    return left


def showing_stale(observed: Sequence[Observed]) -> Bool:
    """[n] STATIC Gaussians that fall where some view's background has to be learnt anew."""
    out = np.zeros(len(observed[0].background.static.rows), bool)
    for one in observed:
        seen = one.background.static
        out |= seen.inside & ~one.background.occluded(seen) & grow(one.stale, 1)[seen.rows, seen.columns]
    return out
