"""What depth cameras measure of what moves: the parts that it is of, and whether it was foreseen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.kernels import Kernels, kernels
from twin_node.forecast.margin import Margin
from twin_node.forecast.part_requests import SurfaceRequest, SurfaceView
from twin_node.forecast.parts import Parts
from twin_node.forecast.unprojection import unproject
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Float32, View


@dataclass(frozen=True)
class MovingSurface:
    """Points of moving surfaces in the inner grid, view by view."""

    parts: NDArray[np.int64]
    """[n] part that holds each; -1 for none: another camera sees past it, or it does not stand out from the ground."""
    foreseen: Bool
    """[n] whether its voxel was forecast."""


@dataclass(frozen=True)
class Moving:
    """A view with depth, and what moves in it."""

    view: View
    mask: Bool
    """[H, W]."""


def moving_surface(seen: Sequence[Moving], margin: Margin, parts: Parts, forecast: NDArray[np.int64]) -> MovingSurface:
    """The points that views measure on what moves, against the `parts` of now and the `forecast` for now.

    `forecast` [m]: flat indices in the inner grid. The parts' indices are of the outer grid, and rise. Compiled;
    `moving_surface_reference` where that cannot be.
    """
    compiled = kernels()
    if compiled is None or not seen:
        return moving_surface_reference(seen, margin, parts, forecast)
    return _found_by(compiled, seen, margin, parts, forecast)


def _found_by(
    compiled: Kernels, seen: Sequence[Moving], margin: Margin, parts: Parts, forecast: NDArray[np.int64]
) -> MovingSurface:
    held = [_arrays(one) for one in seen]  # alive until the call is over
    views = (SurfaceView * len(seen))(
        *(SurfaceView(*one.mask.shape[::-1], *addresses_of(*own)) for one, own in zip(seen, held, strict=True))
    )
    room = sum(one.mask.size for one in seen)
    found, count = MovingSurface(np.empty(room, np.int64), np.empty(room, np.bool_)), np.zeros(1, np.int64)
    grids = (margin.inner, margin.outer)
    arrays: tuple[NDArray[np.generic], ...] = (
        *(np.array(grid.dims, np.int32) for grid in grids),
        *(np.ascontiguousarray(grid.origin, np.float64) for grid in grids),
        *(np.ascontiguousarray(rows, np.int64) for rows in (forecast, parts.indices, parts.labels)),
        *(found.parts, found.foreseen, count),
    )
    sizes = (len(forecast), len(parts.indices), len(seen), margin.inner.voxel_size)
    compiled.run(SurfaceRequest(*sizes, *addresses_of(*arrays), views))
    return MovingSurface(found.parts[: count[0]], found.foreseen[: count[0]])


def _arrays(one: Moving) -> tuple[NDArray[np.generic], ...]:
    camera = one.view.camera
    return (
        np.ascontiguousarray(one.view.depth, np.float32),
        np.ascontiguousarray(one.mask, np.bool_),
        np.ascontiguousarray(camera.K, np.float64),
        np.ascontiguousarray(camera.T_base_cam, np.float64),
    )


def moving_surface_reference(
    seen: Sequence[Moving], margin: Margin, parts: Parts, forecast: NDArray[np.int64]
) -> MovingSurface:
    """What `moving_surface` does."""
    held, foreseen = [np.zeros(0, np.int64)], [np.zeros(0, np.bool_)]
    expected = np.zeros(margin.inner.size, np.bool_)
    expected[forecast] = True
    voxels, labels = np.append(parts.indices, margin.outer.size), np.append(parts.labels, -1)
    for one in seen:
        points = _points(one, margin)
        places = margin.outer.indices(points)
        nearest = np.searchsorted(voxels, places)
        held.append(np.where(voxels[nearest] == places, labels[nearest], -1))
        foreseen.append(expected[margin.inner.indices(points)])
    return MovingSurface(np.concatenate(held), np.concatenate(foreseen))


def places_of(seen: Sequence[Moving], margin: Margin) -> NDArray[np.int64]:
    """[n] flat indices in the outer grid of the points that `moving_surface` finds, in its order."""
    return np.concatenate([np.zeros(0, np.int64), *(margin.outer.indices(_points(one, margin)) for one in seen)])


def _points(one: Moving, margin: Margin) -> Float32:
    """[n, 3] m, those in the inner grid."""
    assert one.view.depth is not None
    points = unproject(one.view, one.mask & (one.view.depth > 0), finer=1)
    return points[margin.inner.indices(points) >= 0]
