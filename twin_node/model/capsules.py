"""What of an arm's capsules is nearest to points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin_node.model.kernel_requests import CapsuleRequest
from twin_node.model.kernels import kernels
from twin_node.native_library import addresses_of
from twin_node.scene import Float64

SHORTEST_SQUARE = 1e-12
"""m^2 of an axis that is divided by: a ball's has no length."""


class NearestCapsules(NamedTuple):
    """Of each of n points."""

    gaps: Float64
    """[n] m to the nearest surface; negative inside."""
    capsules: NDArray[np.int64]
    """[n] whose surface that is; of equally near ones the first."""
    shares: Float64
    """[n] 0 to 1: where on that capsule's axis the nearest place is."""


def nearest_capsules(ends: Float64, radii: Float64, points: Float64) -> NearestCapsules:
    """What of capsules, axes between `ends` [C, 2, 3] m and `radii` [C] m, is nearest to points [3, n] m."""
    library = kernels()
    if library is None:
        return nearest_reference(ends, radii, points)
    given = [np.ascontiguousarray(of, np.float64) for of in (ends, radii, points)]
    count = points.shape[1]
    found = NearestCapsules(np.empty(count), np.empty(count, np.int64), np.empty(count))
    library.run(CapsuleRequest(count, len(radii), SHORTEST_SQUARE, *addresses_of(*given, *found)))
    return found


def nearest_reference(ends: Float64, radii: Float64, points: Float64) -> NearestCapsules:
    """The same in NumPy: the reference of the compiled kernel."""
    count = points.shape[1]
    found = NearestCapsules(np.full(count, np.inf), np.zeros(count, np.int64), np.zeros(count))
    for index, ((begin, end), radius) in enumerate(zip(ends, radii, strict=True)):
        axis = end - begin
        share = np.clip(axis @ (points - begin[:, None]) / max(float(axis @ axis), SHORTEST_SQUARE), 0, 1)
        gaps = np.linalg.norm(points - begin[:, None] - axis[:, None] * share, axis=0) - radius
        closer = gaps < found.gaps
        np.copyto(found.gaps, gaps, where=closer)
        np.copyto(found.capsules, index, where=closer)
        np.copyto(found.shares, share, where=closer)
    return found
