"""Small things that move by themselves: followed as wholes, in space, from set to set."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from twin_node.forecast.flights import Course
from twin_node.forecast.kernel_requests import LinkRequest
from twin_node.forecast.kernels import kernels
from twin_node.forecast.parts import PART_SIZE, Parts
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Float64, Grid

LARGEST = 0.45
"""Longest side of what is followed as a whole, m: limbs bend, and what is larger is rarely seen as a whole."""
_TOGETHER = 1.6
"""Parts are of one thing if their middles are no further apart, parts: neighbours, also those across an edge."""
_FEWEST = 4
"""Voxels of the smallest thing."""
_ALIKE = 1.6
"""A thing is taken for another of at most so many times its volume."""
_FASTEST = 15.0
"""m/s: half as fast again as a throw overarm."""


@dataclass(frozen=True)
class Whole:
    """What following wholes tells of M parts."""

    velocities: Float64
    """[M, 3] m/s; 0 where nothing is told."""
    sigmas: Float64
    """[M] standard deviation of each component, m/s; infinite for parts of nothing that was followed."""
    flying: Bool
    """[M] parts of what falls freely, or goes faster than people do."""
    falling: Bool
    """[M] parts of what flies by more than its last step, and was not seen to go straight."""
    above: Float64
    """[M] m, by which the middle of each part is above the lowest of its thing; 0 where nothing was followed."""

    @classmethod
    def none(cls, count: int) -> Whole:
        """Of `count` parts of nothing that was followed."""
        no = np.zeros(count, np.bool_)
        return cls(np.zeros((count, 3)), np.full(count, np.inf), no, no.copy(), np.zeros(count))

    @property
    def trusts(self) -> Float64:
        """[M] s^2/m^2, the inverse of the variance of each component."""
        trusts: Float64 = 1 / self.sigmas**2
        return trusts

    @property
    def followed(self) -> Bool:
        """[M] parts of what was followed as a whole."""
        followed: Bool = np.isfinite(self.sigmas)
        return followed


class Things:
    """Follows things, set by set."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._before: _Seen | None = None

    def follow(self, stamp: int, cameras: tuple[str, ...], parts: Parts) -> Whole:
        """How the things move that the parts at `stamp` (ns) are of, by their places in the set before.

        Only sets that came of the same `cameras` are compared: what another one sees of a thing has another middle.
        """
        labels = _things(parts)
        now = _Seen.of(stamp, cameras, self._grid, parts, labels)
        before, self._before = self._before, now
        whole = Whole.none(parts.count)
        if before is None or before.stamp >= stamp or before.cameras != cameras:
            return whole
        for mine, other in _pairs(before, now, (stamp - before.stamp) * 1e-9):
            changed = abs(now.volumes[mine] / before.volumes[other] - 1)
            sigma = self._grid.voxel_size / 2 + changed * now.sides[mine] / 4
            course = before.courses[other].followed(stamp * 1e-9, now.middles[mine], sigma)
            now.courses[mine], chosen = course, labels == mine
            whole.velocities[chosen], whole.sigmas[chosen] = course.velocity, course.velocity_sigma
            whole.flying[chosen], whole.falling[chosen] = course.flies, course.is_flight
            whole.above[chosen] = parts.centers[chosen, 2] - now.lowest[mine]
        return whole


@dataclass(frozen=True)
class _Seen:
    """The things of one set."""

    stamp: int
    cameras: tuple[str, ...]
    middles: Float64
    """[T, 3] m, of the voxels that are occupied more likely than not."""
    volumes: Float64
    """[T] voxels of these."""
    sides: Float64
    """[T] m, the longest of each."""
    chosen: Bool
    """[T] small enough, and not cut off by the grid's border."""
    lowest: Float64
    """[T] m, the height of the lowest of each."""
    courses: list[Course]
    """[T] that led there."""

    @classmethod
    def of(cls, stamp: int, cameras: tuple[str, ...], grid: Grid, parts: Parts, labels: NDArray[np.int64]) -> _Seen:
        """By the thing `labels` [M] of parts."""
        count = int(labels.max(initial=-1)) + 1
        likely = labels[parts.labels[parts.likely]]
        order = np.argsort(likely, kind="stable")
        places = np.stack(np.unravel_index(parts.indices[parts.likely][order], grid.dims), axis=1)
        volumes = np.bincount(likely, minlength=count).astype(np.float64)
        firsts = (np.cumsum(volumes) - volumes).astype(np.int64)
        lowest, highest, sums = (by.reduceat(places, firsts) for by in (np.minimum, np.maximum, np.add))
        middles = grid.origin + (sums / volumes[:, None] + 0.5) * grid.voxel_size
        squares = np.add.reduceat(places**2, firsts) / volumes[:, None] - (sums / volumes[:, None]) ** 2
        sides = np.sqrt(12 * squares.max(axis=1) + 1) * grid.voxel_size
        # what lies on the grid's bottom, a table or the floor, is not cut off there
        whole = (lowest[:, :2] > 0).all(axis=1) & (highest < np.array(grid.dims) - 1).all(axis=1)
        chosen = (sides <= LARGEST) & (volumes >= _FEWEST) & whole
        courses = [Course.begun(stamp * 1e-9, middle, grid.voxel_size / 2) for middle in middles]
        bottoms = grid.origin[2] + lowest[:, 2] * grid.voxel_size
        return cls(stamp, cameras, middles, volumes, sides, chosen, bottoms, courses)


def _things(parts: Parts) -> NDArray[np.int64]:
    """Thing [M] of each part: parts that hang together. Rims hang on the nearest part that is more than a rim."""
    solid = np.flatnonzero(np.bincount(parts.labels[parts.likely], minlength=parts.count))
    labels = np.full(parts.count, -1, np.int64)
    if len(solid) == 0:
        return labels
    tree = cKDTree(parts.centers[solid])
    mine = np.append(pieces_of(tree), -1)
    labels[:] = mine[tree.query(parts.centers, distance_upper_bound=_TOGETHER * PART_SIZE)[1]]
    return labels


def pieces_of(centers: cKDTree) -> NDArray[np.int64]:
    """[M] piece that each of M parts is of, by their middles (m): neighbours hang together."""
    return hanging_together(centers.n, centers.query_pairs(_TOGETHER * PART_SIZE, output_type="ndarray"))


def hanging_together(count: int, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """[count] piece of each node, in the order of their first nodes, where `pairs` [n, 2] hang together.

    Compiled; `hanging_together_plainly` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return hanging_together_plainly(count, pairs)
    pieces, links = np.empty(count, np.int64), np.ascontiguousarray(pairs, np.int64)
    compiled.link(LinkRequest(count, len(links), *addresses_of(links, pieces)))
    return pieces


def hanging_together_plainly(count: int, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """What `hanging_together` does."""
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    pieces: NDArray[np.int64] = connected_components(links, directed=False)[1].astype(np.int64)
    return pieces


def _pairs(before: _Seen, now: _Seen, elapsed_s: float) -> list[tuple[int, int]]:
    """Things of now and of before that are each other's nearest, where their velocities led."""
    mine, others = np.flatnonzero(now.chosen), np.flatnonzero(before.chosen)
    if len(mine) == 0 or len(others) == 0:
        return []
    led = before.middles[others] + np.stack([before.courses[other].velocity for other in others]) * elapsed_s
    ways = np.linalg.norm(now.middles[mine][:, None] - led, axis=2)
    steps = np.linalg.norm(now.middles[mine][:, None] - before.middles[others], axis=2)
    ratios = now.volumes[mine][:, None] / before.volumes[others]
    ways = np.where((np.maximum(ratios, 1 / ratios) < _ALIKE) & (steps < _FASTEST * elapsed_s), ways, np.inf)
    nearest = ways.argmin(axis=1)
    return [
        (int(mine[row]), int(others[other]))
        for row, other in enumerate(nearest.tolist())
        if np.isfinite(ways[row, other]) and ways[:, other].argmin() == row
    ]
