"""Persistence at equal recall, against made-up truths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from twin_node.bench.equal_recall import PersistenceGrowth
from twin_node.forecast.growth import PER_VOXEL, Points, spread
from twin_node.forecast.score import contains, litres_per_voxel
from twin_node.nodes.truth import LaterTruth
from twin_node.scene import Bool, Float64, Grid, Occupancy, OccupancyLayer, View

GRID = Grid(np.array([-0.5, -0.5, 1.0]), 0.05, (20, 20, 10))
EDGE = GRID.voxel_size


@dataclass
class Known:
    """Points [n, 3] that are occupied at stamps."""

    at: Mapping[int, Float64] = field(default_factory=dict)
    source: str = "made up"

    def points(self, stamp: int, evidence: int) -> Float64 | None:
        return self.at.get(stamp)

    def occupied(self, stamp: int) -> Float64 | None:
        return None

    def volume_l(self, stamp: int) -> float | None:
        return None

    def pixels(self, view: View) -> Bool | None:
        return None


def middles(places: NDArray[np.int32]) -> Float64:
    """[n, 3] of the voxels `places` [3, n], m."""
    return GRID.origin + (places.T + 0.5) * EDGE


def voxels(*places: tuple[int, int, int]) -> NDArray[np.int32]:
    """[3, n] of so many."""
    return np.array(places, np.int32).reshape(-1, 3).T


def seen_to_move(stamp: int, places: NDArray[np.int32]) -> Occupancy:
    """Voxels [3, n] that move at a stamp, ns."""
    indices = grown(places, 0.0)
    moving = OccupancyLayer(0, indices, np.full(len(indices), 255, np.uint8))
    nothing = OccupancyLayer(0, indices[:0], moving.probability[:0])
    return Occupancy(stamp, stamp, GRID, (moving,), nothing, np.zeros((0, 2), np.uint32))


def grown(places: NDArray[np.int32], radius: float) -> NDArray[np.uint32]:
    """Flat indices of voxels and what is around them."""
    count = places.shape[1]
    points = Points(places, np.zeros(count, np.int64), np.ones(count, np.bool_))
    reach = np.array([[round(PER_VOXEL * radius / EDGE)]], np.uint16)
    return spread(GRID, points, np.zeros((1, 1, 3), np.int32), reach)[0].indices


def test_a_voxel_that_went_three_further_costs_a_ball_of_three_voxels() -> None:
    seen, later = voxels((5, 5, 5)), voxels((8, 5, 5))
    growth = PersistenceGrowth(GRID, Known({1: middles(later)}))
    growth.add(seen, 0, 1)
    growth.settle(1)
    told = growth.grown_to(1.0)
    assert told is not None
    assert told.radius_m == pytest.approx(3 * EDGE)
    assert told.volume_l == pytest.approx(123 * litres_per_voxel(GRID))


@pytest.mark.parametrize("recall", [0.02, 0.5, 0.9, 0.93, 1.0])
def test_it_grows_no_farther_than_it_must_to_find_as_much_of_all_points(recall: float) -> None:
    """One set of two thousand points that stay, beside many of few that move, as of a person and of a ball."""
    rng = np.random.default_rng(3)
    crowd = np.stack(np.unravel_index(rng.choice(GRID.size, 2000, replace=False), GRID.dims)).astype(np.int32)
    seen = {0: crowd, **{stamp: rng.integers(0, 10, (3, 4)).astype(np.int32) for stamp in range(1, 40)}}
    at = {stamp: middles(places) + rng.uniform(0, 0.3, 3) * (stamp > 0) for stamp, places in seen.items()}
    growth = PersistenceGrowth(GRID, Known(at))
    for stamp, places in seen.items():
        growth.add(places, 0, stamp)
    growth.settle(40)

    def found(radius: float) -> float:
        inside = {stamp: GRID.indices(at[stamp]) for stamp in seen}
        held = [contains(GRID, grown(seen[stamp], radius), true[true >= 0]) for stamp, true in inside.items()]
        return float(np.concatenate(held).mean())

    told = growth.grown_to(recall)
    assert told is not None
    assert found(told.radius_m) >= recall
    assert told.radius_m == 0 or found(told.radius_m - EDGE / PER_VOXEL) < recall
    volumes = [len(grown(places, told.radius_m)) * litres_per_voxel(GRID) for places in seen.values()]
    assert told.volume_l == pytest.approx(np.mean(volumes))


def test_what_the_truth_forgets_later_counts_all_the_same() -> None:
    """Something moves by two voxels from set to set for far longer than the truth remembers, then stands for as
    long."""
    truth = LaterTruth()
    growth, period = PersistenceGrowth(GRID, truth), 100_000_000
    for number in range(400):
        place = voxels((min(2 * number, 400) % 20, 5, 5))
        truth.remember(seen_to_move(number * period, place))
        growth.settle(number * period)
        growth.add(place, 0, (number + 1) * period)
    told = growth.grown_to(0.4)
    assert told is not None
    assert told.radius_m == pytest.approx(0)
    told = growth.grown_to(0.52)
    assert told is not None
    assert told.radius_m == pytest.approx(2 * EDGE)


def test_sets_whose_time_has_not_come_do_not_count() -> None:
    growth = PersistenceGrowth(GRID, Known({1: middles(voxels((5, 5, 5))), 9: middles(voxels((15, 15, 5)))}))
    growth.add(voxels((5, 5, 5)), 0, 1)
    growth.add(voxels((5, 5, 5)), 0, 9)
    growth.settle(8)
    told = growth.grown_to(1.0)
    assert told is not None and told.radius_m == 0


def test_nothing_seen_cannot_grow() -> None:
    growth = PersistenceGrowth(GRID, Known({0: middles(voxels((5, 5, 5)))}))
    growth.add(voxels(), 0, 0)
    growth.settle(0)
    assert growth.grown_to(0.9) is None
    assert PersistenceGrowth(GRID, Known()).grown_to(0.9) is None
