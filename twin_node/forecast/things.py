"""Small things that move by themselves: followed as wholes, in space, from set to set."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.flights import Course
from twin_node.forecast.kernels import kernels
from twin_node.forecast.part_requests import GatherRequest, LinkRequest
from twin_node.forecast.parts import PART_SIZE, Parts
from twin_node.forecast.tracks import MOST_SPEED, ONE_TIME_S
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Float64, Grid

LARGEST = 0.45
"""Longest side of what is followed as a whole, m: limbs bend, and what is larger is rarely seen as a whole."""
_REACH = 1.6 * PART_SIZE
"""Parts are of one thing if their middles are no further apart, m: neighbours, also those across an edge."""
_FEWEST = 4
"""Voxels of the smallest thing."""
_ALIKE = 1.6
"""A thing is taken for another of at most so many times its volume."""


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
    seen_falling: Bool
    """[M] parts of what is seen to fall freely, and not only taken for that."""
    rested: Bool
    """[M] parts of what has kept still since it was first followed (`Course.has_rested`)."""
    above: Float64
    """[M] m, by which the middle of each part is above the lowest of its thing; 0 where nothing was followed."""

    @classmethod
    def none(cls, count: int) -> Whole:
        """Of `count` parts of nothing that was followed."""
        no = np.zeros(count, np.bool_)
        zeros, never = np.zeros((count, 3)), np.full(count, np.inf)
        return cls(zeros, never, no, no.copy(), no.copy(), no.copy(), np.zeros(count))

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

    @property
    def alone(self) -> Bool:
        """[M] parts of what was followed as a whole and has never rested: no limbs."""
        alone: Bool = self.followed & ~self.rested
        return alone


class Things:
    """Follows things, set by set."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._before: _Seen | None = None
        self._earlier: _Seen | None = None
        """The one before that, of another time."""

    def follow(self, stamp: int, cameras: tuple[str, ...], parts: Parts) -> Whole:
        """How the things move that the parts at `stamp` (ns) are of, by their places in the set before.

        Only sets that came of the same `cameras` are compared: what another one sees of a thing has another middle. Of
        two of one time the later one holds.
        """
        gathered = gather(parts)
        labels, now = gathered.labels, _Seen.of(stamp, cameras, self._grid, gathered)
        if self._before is None or abs(stamp - self._before.stamp) > ONE_TIME_S * 1e9:
            self._earlier = self._before
        before, self._before = self._earlier, now
        whole = Whole.none(parts.count)
        if before is None or before.stamp >= stamp or before.cameras != cameras:
            return whole
        for mine, other in _pairs(before, now, (stamp - before.stamp) * 1e-9):
            changed = abs(now.volumes[mine] / before.volumes[other] - 1)
            sigma = self._grid.voxel_size / 2 + changed * now.sides[mine] / 4
            course = before.course_of(other, self._grid).followed(stamp * 1e-9, now.middles[mine], sigma)
            now.courses[mine], now.velocities[mine], chosen = course, course.velocity, labels == mine
            whole.velocities[chosen], whole.sigmas[chosen] = course.velocity, course.velocity_sigma
            whole.flying[chosen], whole.falling[chosen] = course.flies, course.is_flight
            whole.seen_falling[chosen], whole.rested[chosen] = bool(course.falls), course.has_rested
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
    velocities: Float64
    """[T, 3] m/s, of their courses; 0 for those that begin."""
    courses: dict[int, Course]
    """That led there, of those that were followed, by their places in the arrays."""

    @classmethod
    def of(cls, stamp: int, cameras: tuple[str, ...], grid: Grid, things: Gathered) -> _Seen:
        """At a time (ns), by some cameras."""
        volumes = things.volumes.astype(np.float64)
        middles = grid.origin + (things.sums / volumes[:, None] + 0.5) * grid.voxel_size
        squares = things.squares / volumes[:, None] - (things.sums / volumes[:, None]) ** 2
        sides = np.sqrt(12 * squares.max(axis=1) + 1) * grid.voxel_size
        # what lies on the grid's bottom, a table or the floor, is not cut off there
        whole = (things.lowest[:, :2] > 0).all(axis=1) & (things.highest < np.array(grid.dims) - 1).all(axis=1)
        chosen = (sides <= LARGEST) & (volumes >= _FEWEST) & whole
        bottoms = grid.origin[2] + things.lowest[:, 2] * grid.voxel_size
        return cls(stamp, cameras, middles, volumes, sides, chosen, bottoms, np.zeros_like(middles), {})

    def course_of(self, thing: int, grid: Grid) -> Course:
        """That led a thing there, or begins there."""
        if thing in self.courses:
            return self.courses[thing]
        return Course.begun(self.stamp * 1e-9, self.middles[thing], grid.voxel_size / 2)


@dataclass(frozen=True)
class Gathered:
    """The T things that M parts are of: parts that hang together."""

    labels: NDArray[np.int64]
    """[M] thing of each part. Rims hang on the nearest part that is more than a rim; -1 for those far from all."""
    volumes: NDArray[np.int64]
    """[T] voxels that are no rims, as all that follows."""
    lowest: NDArray[np.int64]
    """[T, 3] least coordinates."""
    highest: NDArray[np.int64]
    """[T, 3] greatest coordinates."""
    sums: NDArray[np.int64]
    """[T, 3] of coordinates."""
    squares: NDArray[np.int64]
    """[T, 3] sums of squared coordinates."""


def gather(parts: Parts) -> Gathered:
    """The things that parts are of. Compiled; `gather_reference` where that cannot be."""
    compiled = kernels()
    if compiled is None:
        return gather_reference(parts)
    labels, extents = np.empty(parts.count, np.int64), np.empty((parts.count, 13), np.int64)
    given = tuple(np.ascontiguousarray(array) for array in (parts.places, parts.labels, parts.likely, parts.centers))
    count = np.empty(1, np.int64)
    addresses = addresses_of(*given, labels, extents, count)
    compiled.run(GatherRequest(len(parts.labels), parts.count, _REACH, *addresses))
    extents = extents[: count[0]]
    return Gathered(labels, extents[:, 0], *(extents[:, first : first + 3] for first in (1, 4, 7, 10)))


def gather_reference(parts: Parts) -> Gathered:
    """What `gather` does."""
    things = _things(parts)
    likely = things[parts.labels[parts.likely]]
    order = np.argsort(likely, kind="stable")
    places = parts.places[:, parts.likely].T[order].astype(np.int64)
    volumes = np.bincount(likely, minlength=int(things.max(initial=-1)) + 1)
    firsts = np.cumsum(volumes) - volumes
    lowest, highest, sums = (by.reduceat(places, firsts) for by in (np.minimum, np.maximum, np.add))
    return Gathered(things, volumes, lowest, highest, sums, np.add.reduceat(places**2, firsts))


def _things(parts: Parts) -> NDArray[np.int64]:
    """Thing [M] of each part."""
    solid = np.flatnonzero(parts.solid)
    labels = np.full(parts.count, -1, np.int64)
    if len(solid) == 0:
        return labels
    labels[solid] = pieces_of_reference(parts.centers[solid])
    for rim in np.setdiff1d(np.arange(parts.count), solid):
        squares = ((parts.centers[solid] - parts.centers[rim]) ** 2).sum(axis=1)
        nearest = squares.argmin()
        labels[rim] = labels[solid[nearest]] if squares[nearest] < _REACH**2 else -1
    return labels


def pieces_of(centers: Float64, reach: float = _REACH) -> NDArray[np.int64]:
    """[M] piece that each of M parts is of, in the order of their first ones, by their middles [M, 3] (m).

    Neighbours, no further apart than `reach`, hang together. Compiled; `pieces_of_reference` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return pieces_of_reference(centers, reach)
    pieces, middles = np.empty(len(centers), np.int64), np.ascontiguousarray(centers, np.float64)
    compiled.run(LinkRequest(len(centers), reach, *addresses_of(middles, pieces)))
    return pieces


def pieces_of_reference(centers: Float64, reach: float = _REACH) -> NDArray[np.int64]:
    """What `pieces_of` does."""
    from scipy.sparse import coo_array  # loads slowly, and kernels do without
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    count, pairs = len(centers), cKDTree(centers).query_pairs(reach, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    pieces: NDArray[np.int64] = connected_components(links, directed=False)[1].astype(np.int64)
    return pieces


def _pairs(before: _Seen, now: _Seen, elapsed_s: float) -> list[tuple[int, int]]:
    """Things of now and of before that are each other's nearest, where their velocities led."""
    mine, others = np.flatnonzero(now.chosen), np.flatnonzero(before.chosen)
    if len(mine) == 0 or len(others) == 0:
        return []
    led = before.middles[others] + before.velocities[others] * elapsed_s
    ways = np.linalg.norm(now.middles[mine][:, None] - led, axis=2)
    steps = np.linalg.norm(now.middles[mine][:, None] - before.middles[others], axis=2)
    ratios = now.volumes[mine][:, None] / before.volumes[others]
    ways = np.where((np.maximum(ratios, 1 / ratios) < _ALIKE) & (steps < MOST_SPEED * elapsed_s), ways, np.inf)
    nearest = ways.argmin(axis=1)
    return [
        (int(mine[row]), int(others[other]))
        for row, other in enumerate(nearest.tolist())
        if np.isfinite(ways[row, other]) and ways[:, other].argmin() == row
    ]
