"""Which pixels a rendering of what moves is held to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin_node.model.backgrounds import grow
from twin_node.model.kernel_requests import HeldRequest, HeldView
from twin_node.model.kernels import kernels
from twin_node.model.observation import Observed
from twin_node.model.rays import look
from twin_node.model.rendering import Splats
from twin_node.native_library import addresses_of, array_of, thread_count
from twin_node.scene import Bool

SKIRT_PX = 3
"""Pixels around the active ones that count too, so that nothing moving grows tails over what stands still."""
AROUND_PX = 2
"""The same around the middles of what moves."""


def held_pixels(observed: Sequence[Observed], moving: Splats) -> list[Bool]:
    """Per view [H, W] the pixels that a rendering is held to: where something changed, and where what moves shows.

    `moving` are the Gaussians that move, at each view's time. Behind thin or loose surfaces they shine through: a view
    in which nothing moves there must have its say too.
    """
    library, means = kernels(), moving.means.cpu().contiguous().numpy()
    if library is None:
        return held_reference(observed, means)
    masks = [np.empty(one.usable.shape, bool) for one in observed]
    given = [
        (
            *(np.ascontiguousarray(matrix, np.float64) for matrix in (one.view.camera.viewmat, one.view.camera.K)),
            *(means[index], np.ascontiguousarray(one.active), np.ascontiguousarray(one.usable), masks[index]),
        )
        for index, one in enumerate(observed)
    ]
    views = [
        HeldView(one.view.camera.width, one.view.camera.height, *addresses_of(*arrays))
        for one, arrays in zip(observed, given, strict=True)
    ]
    counts = (len(views), thread_count())
    library.run(HeldRequest(means.shape[1], SKIRT_PX, AROUND_PX, *counts, array_of(HeldView, views)))
    return masks


def held_reference(observed: Sequence[Observed], means: NDArray[np.float32]) -> list[Bool]:
    """The same of means [T, n, 3] m in NumPy: the reference of the compiled kernel."""
    masks = []
    for index, one in enumerate(observed):
        masks.append((grow(one.active, SKIRT_PX) | _footprint(one, means[index])) & one.usable)
    return masks


def _footprint(one: Observed, points: NDArray[np.floating]) -> Bool:
    """[H, W] pixels at and around the projections of points [n, 3]."""
    seen = look(one.view.camera, points)
    mask = np.zeros(one.usable.shape, bool)
    mask[seen.rows[seen.inside], seen.columns[seen.inside]] = True
    return grow(mask, AROUND_PX)
