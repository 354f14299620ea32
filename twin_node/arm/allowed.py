"""Where some of the arm's links may touch what stands."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from twin_node.scene import Float64, ObstacleKind, Obstacles, ObstacleShape


@dataclass(frozen=True)
class AllowedRegion:
    """A box in which some links may touch what stands still, as a gripper does the table it works on.

    What of a STATIC obstacle lies inside is not looked at for these links; of a sphere or a turned box only if all of
    it does. MOVING and UNKNOWN always are.
    """

    lower: Float64
    """[3] lower corner, m, in `base_link`."""
    upper: Float64
    """[3] upper corner, m, in `base_link`."""
    links: tuple[str, ...] = field(default=("wrist_3_link",))
    """Names of links and attachments."""


def cut(obstacles: Obstacles, regions: Iterable[AllowedRegion]) -> Obstacles:
    """The same space, upright STATIC boxes cut along the sides of regions: each lies inside of one, or beside it."""
    for region in regions:
        obstacles = _cut(obstacles, region)
    return obstacles


def _cut(obstacles: Obstacles, region: AllowedRegion) -> Obstacles:
    half = obstacles.sizes / 2
    lower, upper = obstacles.positions - half, obstacles.positions + half
    is_upright = np.abs(obstacles.quats[:, 1:]).max(axis=1, initial=0) == 0
    is_crossed = (obstacles.shapes == ObstacleShape.BOX) & (obstacles.kinds == ObstacleKind.STATIC) & is_upright
    is_crossed &= ((lower < region.upper) & (upper > region.lower)).all(axis=1)
    is_crossed &= ((lower < region.lower) | (upper > region.upper)).any(axis=1)
    if not is_crossed.any():
        return obstacles
    whole, crossed = np.flatnonzero(~is_crossed), np.flatnonzero(is_crossed)
    pieces = [(whole, lower[whole], upper[whole]), *_pieces(crossed, lower[crossed], upper[crossed], region)]
    rows, lowers, uppers = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    columns = {name: values[rows] for name, values in vars(obstacles).items() if isinstance(values, np.ndarray)}
    return replace(obstacles, **columns | {"positions": (lowers + uppers) / 2, "sizes": uppers - lowers})


def _pieces(
    rows: NDArray[np.int64], lower: Float64, upper: Float64, region: AllowedRegion
) -> list[tuple[NDArray[np.int64], Float64, Float64]]:
    """Rows and corners of what `rows` [n], boxes between corners [n, 3], have beside the region, and in it."""
    pieces = []
    for axis in range(3):
        low, high = region.lower[axis], region.upper[axis]
        below, above = lower[:, axis] < low, upper[:, axis] > high
        pieces.append((rows[below], lower[below], _with(upper[below], axis, low)))
        pieces.append((rows[above], _with(lower[above], axis, high), upper[above]))
        lower, upper = (
            _with(lower, axis, np.maximum(lower[:, axis], low)),
            _with(upper, axis, np.minimum(upper[:, axis], high)),
        )
    return [*pieces, (rows, lower, upper)]


def _with(corners: Float64, axis: int, value: Float64 | float) -> Float64:
    """Corners [n, 3] with one coordinate in place of theirs."""
    moved = corners.copy()
    moved[:, axis] = value
    return moved
