"""What may turn back is held along all of its way."""

from __future__ import annotations

import numpy as np
from forecast_worlds import GRID, ball_voxels, state_of
from hypothesis import given
from hypothesis import strategies as st

from twin_node.forecast import Forecaster
from twin_node.forecast.growth import Points, reach_of, shifts_of, spread
from twin_node.forecast.turning import off_the_way, whole_ways
from twin_node.scene import HORIZONS_NS, Occupancy

PERIOD_NS = 33_333_333
LATENCY_NS = 33_000_000
SPEED, HALF_WAY = 0.6, 0.36


def one_part(places: np.ndarray) -> Points:
    return Points(places.astype(np.int32), np.zeros(places.shape[1], np.int64), np.ones(places.shape[1], np.bool_))


@given(st.integers(0, 2**32 - 1), st.floats(-1, 1), st.sampled_from([(4, 0.04), (1, 0.08)]))
def test_whole_ways_hold_every_place_between_ahead_and_behind(
    seed: int, share: float, size_and_radius: tuple[int, float]
) -> None:
    """Of several parts, some of which do not turn: these are held ahead alone."""
    rng, (size, radius), parts = np.random.default_rng(seed), size_and_radius, 3
    block = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing="ij")).reshape(3, -1)
    corners = rng.integers(6, 26, (parts, 3))
    places = np.concatenate([corner[:, None] + block for corner in corners], axis=1).astype(np.int32)
    labels = np.repeat(np.arange(parts), block.shape[1])
    points = Points(places, labels, np.ones(len(labels), np.bool_))
    ahead, turning = rng.uniform(-0.4, 0.4, (1, parts, 3)), rng.uniform(size=parts) < 0.6
    ways = whole_ways(points, ahead, np.full((1, parts), radius), turning)
    held = spread(GRID, ways.points, shifts_of(GRID, ways.displacements), reach_of(GRID, ways.radii))[0].indices
    moved = np.where(turning[:, None], share, 1) * ahead[0]
    found = GRID.indices(GRID.origin + (corners + size / 2) * GRID.voxel_size + moved)
    assert np.isin(found[found >= 0], held).all()


def test_what_does_not_turn_is_left_as_it_is() -> None:
    points = one_part(np.full((3, 1), 20))
    displacements, radii = np.full((5, 1, 3), 0.2), np.full((5, 1), 0.05)
    ways = whole_ways(points, displacements, radii, np.zeros(1, np.bool_))
    assert ways.points is points
    assert ways.displacements is displacements


def test_distance_from_the_way_counts_from_its_ends_and_its_middle() -> None:
    ahead = np.tile([0.1, 0.0, 0.0], (4, 1))
    moved = np.array([[0.15, 0.0, 0.0], [-0.13, 0.0, 0.0], [0.0, 0.02, 0.0], [0.07, 0.0, 0.0]])
    assert np.allclose(off_the_way(ahead, moved), [0.05, 0.03, 0.02, 0.0])


def place(stamp: int) -> np.ndarray:
    """To and fro across the grid, turning on the spot."""
    way = (SPEED * stamp * 1e-9 + HALF_WAY) % (4 * HALF_WAY)
    return np.array([min(way, 4 * HALF_WAY - way) - HALF_WAY, 0.0, 0.45])


def share_held(occupancy: Occupancy) -> float:
    ball = ball_voxels(place(occupancy.publish_stamp + HORIZONS_NS[-1]))
    return float(np.isin(ball, occupancy.layers[-1].indices).mean())


def test_a_turn_is_foreseen_of_what_has_turned_before() -> None:
    forecaster = Forecaster(GRID)
    turn_ns, second_ns = round(HALF_WAY / SPEED * 1e9), round(3 * HALF_WAY / SPEED * 1e9)
    first, second, sizes = [], [], []
    for number in range(second_ns // PERIOD_NS + 1):
        stamp = number * PERIOD_NS
        occupancy = forecaster.update(state_of(stamp, place(stamp), with_depth=True), stamp + LATENCY_NS).occupancy
        if turn_ns - 100_000_000 < stamp < turn_ns:
            first.append(share_held(occupancy))
        if second_ns - 100_000_000 < stamp < second_ns:
            second.append(share_held(occupancy))
            sizes.append(len(occupancy.layers[-1].indices))
    assert min(first) < 0.9
    assert min(second) > 0.97
    everywhere = np.linalg.norm(GRID.centers(np.arange(GRID.size)) - place(second_ns), axis=1) < 0.12 + 0.32
    assert max(sizes) < everywhere.sum()
