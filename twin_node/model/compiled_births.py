"""New Gaussians by the compiled kernels, the views side by side."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin_node.model import birth_depths, births
from twin_node.model.backgrounds import OCCLUSION
from twin_node.model.birth_depths import BLOCK
from twin_node.model.births import SOLID, SPREAD, Births, find_births_reference, joined
from twin_node.model.kernel_requests import BirthRequest, BirthRules, BirthView
from twin_node.model.kernels import kernels
from twin_node.model.observation import Observed
from twin_node.model.quality import MOVING_THRESHOLD
from twin_node.model.rendering import Rendering
from twin_node.native_library import addresses_of, array_of, thread_count


def find_births(
    observed: Sequence[Observed],
    renderings: Sequence[Rendering],
    most: int,
    side: int = BLOCK,
) -> Births:
    """Births, `most` of them, for pixels whose largest channel differs by `MOVING_THRESHOLD` from `renderings`.

    One stands for a block of `BLOCK` pixels squared, or of `side` where all of that is wrong and looks alike.
    """
    library = kernels()
    if library is None:
        return find_births_reference(observed, renderings, most, side)
    quota = most // max(len(observed), 1)
    rules = BirthRules(
        *(MOVING_THRESHOLD, SOLID, birth_depths.COLOUR_SIGMA, births.SAME_DEPTH),
        *(birth_depths.HUGE, birth_depths.REFUTED),
        *(birth_depths.LOCALITY, birth_depths.NEIGHBOUR_PX, birth_depths.FEWEST, birth_depths.DISSENT),
        *(OCCLUSION, SPREAD, births.ALIKE, quota, birth_depths.SAMPLES, side),
    )
    calls = [_Call(one, rendering, quota) for one, rendering in zip(observed, renderings, strict=True)]
    views = array_of(BirthView, [call.view for call in calls])
    library.run(BirthRequest(len(calls), thread_count(), ctypes.pointer(rules), views))
    return joined([call.born(index) for index, call in enumerate(calls)])


class _Call:
    """One view's request, and the arrays that it points to."""

    def __init__(self, one: Observed, rendering: Rendering, quota: int) -> None:
        camera, background = one.view.camera, one.background
        images = (one.rgb, rendering.pixels)
        given: list[NDArray[np.generic] | None] = [
            *(np.ascontiguousarray(matrix, np.float64) for matrix in (camera.viewmat, camera.K, camera.T_base_cam)),
            *(np.ascontiguousarray(image, np.float32) for image in images),
            *(np.ascontiguousarray(surface, np.float64) for surface in (background.depth, background.rays)),
            *(np.ascontiguousarray(image, np.float32) for image in (background.alpha, one.surprise)),
            *(np.ascontiguousarray(mask) for mask in (one.active, one.usable, one.near_moving, one.stale)),
            None if one.view.depth is None else np.ascontiguousarray(one.view.depth, np.float32),
        ]
        self._found = Births(
            np.empty((quota, 3)),
            np.empty(quota),
            np.empty((quota, 3), np.float32),
            np.empty(quota, bool),
            np.empty(quota, bool),
            np.empty(0, np.int64),
        )
        self._count = np.zeros(1, np.int64)
        self._held = [*given, *list(vars(self._found).values())[:-1], self._count]
        self.view = BirthView(camera.width, camera.height, *addresses_of(*self._held))

    def born(self, index: int) -> Births:
        """What the kernel has found for the view number `index`."""
        count, found = int(self._count[0]), self._found
        return Births(
            found.means[:count],
            found.radii[:count],
            found.rgb[:count],
            found.on_background[:count],
            found.lasting[:count],
            np.full(count, index),
        )
