"""What stands still is learnt anew where its look has changed for good: light, shadow, ground that was uncovered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.model.observation import Observed
from twin_node.scene import Bool, Float32

UPTAKE = 0.8
"""Share of what a pixel misses that the Gaussians that show in it take up per rendering of their background: neighbours
that overlap add up, and one view must not overrule the others at once."""

AROUND_PX = 3
"""Side of the square of pixels that a Gaussian answers for."""


@dataclass(frozen=True)
class Revision:
    """New colours for STATIC Gaussians."""

    chosen: NDArray[np.int64]
    """[k] which of `Backgrounds.rows`."""
    missed: Float32
    """[k, 3] what their colours are to be changed by."""


def revise(one: Observed, others: Sequence[Observed], threshold: float) -> Revision:
    """What the Gaussians that show in the stale pixels of a view should take up; its background must be up to date.

    Where one of the `others` (none for a camera that came late) sees the background as it was, to within half of
    `threshold` (0 to 1), only the view from `one` has changed, as by a glare: what all views share then stays.

    Colours alone, and only of what the view sees: where things stand was learnt from all views at rest. This is one
    sweep of Kaczmarz's method on the pixels around the Gaussians' centres, the stale ones among them.
    """
    stale = one.stale.astype(np.float32)
    share = cv2.blur(stale, (AROUND_PX, AROUND_PX))
    missed = cv2.blur((one.rgb - one.background.rgb) * stale[..., None], (AROUND_PX, AROUND_PX))
    seen = one.background.static
    showing = seen.inside & ~one.background.occluded(seen) & (share[seen.rows, seen.columns] > 0)
    chosen = np.flatnonzero(showing & ~_contradicted(others, threshold, len(showing)))
    at = (seen.rows[chosen], seen.columns[chosen])
    return Revision(chosen, np.float32(UPTAKE) * missed[at])


def _contradicted(others: Sequence[Observed], threshold: float, count: int) -> Bool:
    """[count] which of `Backgrounds.rows` some of the views see unchanged."""
    contradicted = np.zeros(count, bool)
    for other in others:
        seen = other.background.static
        at = (seen.rows, seen.columns)
        visible = seen.inside & ~other.background.occluded(seen) & (other.usable & ~other.near_moving)[at]
        contradicted |= visible & (other.surprise[at] < 0.5 * threshold)
    return contradicted
