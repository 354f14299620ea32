"""Which Gaussians the images refute: moving ones that a camera sees through, static ones that are no longer there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin_node.model.observation import Observed, grow, project_all
from twin_node.model.rays import Seen
from twin_node.scene import Bool, Float64

SEEN_THROUGH = 0.05
"""Share of its depth by which a measured surface must lie behind a Gaussian to refute it."""


def refuted_moving(observed: Sequence[Observed], means: Sequence[Float64], threshold: float) -> Bool:
    """[n] moving Gaussians that some view sees through: it shows the background, unmoved, where they are.

    `means` [n, 3] per view, at its time; `threshold` largest |image - background| that counts as background.
    """
    refuted = np.zeros(len(means[0]), bool)
    for one, seen in zip(observed, project_all(observed, means), strict=True):
        visible = seen.inside & ~one.occluded(seen) & one.usable[seen.rows, seen.columns]
        background = one.surprise[seen.rows, seen.columns] < threshold
        refuted |= visible & background & ~one.near_moving[seen.rows, seen.columns]
        if one.view.depth is not None:
            surface = one.view.depth[seen.rows, seen.columns]
            refuted |= visible & (surface > (1 + SEEN_THROUGH) * seen.depth)
    return refuted


def refuted_static(observed: Sequence[Observed], static: Sequence[Seen], threshold: float) -> Bool:
    """[n] STATIC Gaussians that have left: every view that should show them shows something else.

    `static` says where they fall in each view. Two views must say so (one, where the rig has but one or measures depth behind the Gaussian): a single view cannot tell
    a thing that left from one that is covered.
    """
    count = len(static[0].rows)
    shown = np.zeros(count, np.int64)
    gone = np.zeros(count, np.int64)
    proven = np.zeros(count, bool)
    for one, seen in zip(observed, static, strict=True):
        visible = seen.inside & ~one.occluded(seen) & one.usable[seen.rows, seen.columns]
        changed = (one.surprise[seen.rows, seen.columns] > threshold) & one.near_moving[seen.rows, seen.columns]
        shown += visible
        gone += visible & changed
        if one.view.depth is not None:
            surface = one.view.depth[seen.rows, seen.columns]
            proven |= visible & (surface > (1 + SEEN_THROUGH) * seen.depth)
    enough = min(2, len(observed))
    return proven | ((gone == shown) & (gone >= enough))


def showing_stale(observed: Sequence[Observed], static: Sequence[Seen]) -> Bool:
    """[n] STATIC Gaussians that fall where some view's background has to be learnt anew."""
    out = np.zeros(len(static[0].rows), bool)
    for one, seen in zip(observed, static, strict=True):
        out |= seen.inside & ~one.occluded(seen) & grow(one.stale, 1)[seen.rows, seen.columns]
    return out
