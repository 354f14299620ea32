"""How much of what the cameras now see to move lies inside the forecast that was made for now."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.margin import Margin
from twin_node.forecast.static import unproject
from twin_node.forecast.tables import RigTables
from twin_node.scene import Bool, TwinState, View


@dataclass(frozen=True)
class Held:
    """What was seen, and how much of it was foreseen: pixels, or points of measured surfaces."""

    seen: int
    covered: int


def held(
    state: TwinState, margin: Margin, tables: RigTables, here: NDArray[np.int64], forecast: NDArray[np.int64]
) -> Held:
    """Scores a forecast, the voxels `forecast` [n] of the inner grid, against what the images show of `here`.

    `here` [m]: voxels of the outer grid that hold what moves and was there to be foreseen. A camera with depth judges
    by the points of the moving surface that it measures. One without judges by its pixels: in space the hull holds more
    than what moves, and flickers.
    """
    known = _mask(margin.outer.size, here)
    foreseen = _mask(margin.outer.size, margin.outer_indices(forecast))
    seen = covered = 0
    for view, moving in zip(state.frames.views, state.moving_masks, strict=True):
        if view.depth is not None:
            places = _measured(view, moving, margin)
            places = places[known[places]]
            seen += len(places)
            covered += int(np.count_nonzero(foreseen[places]))
            continue
        table = tables.of(view.camera)
        explained = moving & table.image_of(tables.blocks.locate(here))
        seen += int(np.count_nonzero(explained))
        covered += int(np.count_nonzero(explained & table.image_of(tables.blocks.locate(np.flatnonzero(foreseen)))))
    return Held(seen, covered)


def _measured(view: View, moving: Bool, margin: Margin) -> NDArray[np.int64]:
    """Voxels of the outer grid that hold measured points of what moves, inside the inner one."""
    assert view.depth is not None
    points = unproject(view, moving & (view.depth > 0), finer=1)
    points = points[margin.inner.indices(points) >= 0]
    return margin.outer.indices(points)


def _mask(size: int, indices: NDArray[np.int64]) -> Bool:
    mask = np.zeros(size, np.bool_)
    mask[indices] = True
    return mask
