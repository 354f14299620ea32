from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_node.forecast import PartMotion, cover
from twin_node.forecast.parts import Parts, split
from twin_node.forecast.passing import passed_between
from twin_node.scene import HORIZONS_NS, Bool, Float64, Grid, ObstacleKind, Occupancy, OccupancyLayer

GRID = Grid(np.array([-0.2, -0.4, 0.1]), 0.02, (120, 40, 30))
BEGIN = np.array([0.0, 0.05, 0.4])


def ahead(x: float) -> Float64:
    return BEGIN + np.array([x, 0.0, 0.0])


def thing(at: Float64, size: float = 0.05) -> np.ndarray:
    """Flat indices of a cube's voxels."""
    centers = GRID.centers(np.arange(GRID.size))
    return np.flatnonzero((np.abs(centers - at) < size / 2).all(axis=1))


def thrown(speed: float, radius: float) -> tuple[Parts, Float64, Float64]:
    """A thing's parts, its displacements along x and its bounds at the horizons."""
    indices = thing(BEGIN)
    parts = split(GRID, indices, np.ones(len(indices), np.bool_))
    displacements = np.zeros((len(HORIZONS_NS), parts.count, 3))
    displacements[..., 0] = speed * np.array(HORIZONS_NS)[:, None] * 1e-9
    return parts, displacements, np.full((len(HORIZONS_NS), parts.count), radius)


def held(indices: np.ndarray, at: Float64) -> Bool:
    return np.isin(thing(at), indices)


@pytest.mark.parametrize(("speed", "radius"), [(0.0, 0.0), (1.5, 0.0), (5.0, 0.2)])
def test_nothing_is_added_for_what_the_layers_hold(speed: float, radius: float) -> None:
    assert all(len(passed) == 0 for passed in passed_between(GRID, *thrown(speed, radius)))


@pytest.mark.parametrize("speed", [3.0, 4.0, 6.0, 9.0])
def test_a_fast_thing_is_held_all_along_its_way(speed: float) -> None:
    passed = passed_between(GRID, *thrown(speed, 0.05))
    for interval in range(len(HORIZONS_NS) - 1):
        ends = [thing(ahead(speed * HORIZONS_NS[k] * 1e-9), 0.15) for k in (interval, interval + 1)]
        for share in np.linspace(0, 1, 11):
            middle = ahead(speed * (interval + share) * 0.05)
            assert held(np.concatenate([*ends, passed[interval]]), middle).all()
    before_and_behind = [ahead(x) for x in (-0.15, 0.2 * speed + 0.15)]
    assert not any(held(np.concatenate(passed), at).any() for at in before_and_behind)


def test_the_way_is_as_wide_as_the_bound_grows_on_it() -> None:
    speed, (parts, displacements, radii) = 8.0, thrown(8.0, 0.05)
    radii[2] = 0.15
    passed = passed_between(GRID, parts, displacements, radii)
    aside = np.array([0.0, 0.12, 0.0])  # half of the thing, and the mean of both bounds
    assert np.isin(thing(ahead(speed * 0.075) + aside, 0.03), passed[1]).all()
    assert not np.isin(thing(ahead(speed * 0.025) + aside, 0.03), passed[0]).any()


def test_a_bound_that_has_grown_by_the_end_of_a_way_leaves_nothing_out_before() -> None:
    """By the wider one of both ends its places would be too far apart for the narrower one's."""
    parts, displacements, radii = thrown(4.5, 0.01)
    radii[2:] = 0.2
    passed = passed_between(GRID, parts, displacements, radii)
    assert held(passed[1], ahead(4.5 * 0.075)).all()


def test_ways_of_any_length_are_no_more_than_a_few_places() -> None:
    parts, displacements, radii = thrown(1e9, 0.05)
    assert len(passed_between(GRID, parts, displacements, radii)) == len(HORIZONS_NS) - 1


def test_obstacles_hold_what_is_passed_between_their_horizons() -> None:
    parts, displacements, radii = thrown(8.0, 0.02)
    places = [thing(BEGIN + moved[0]).astype(np.uint32) for moved in displacements]
    layers = tuple(
        OccupancyLayer(horizon, indices, np.full(len(indices), 230, np.uint8))
        for horizon, indices in zip(HORIZONS_NS, places, strict=True)
    )
    nothing = OccupancyLayer(0, np.zeros(0, np.uint32), np.zeros(0, np.uint8))
    occupancy = Occupancy(0, 33_000_000, GRID, layers, nothing, np.zeros((0, 2), np.uint32))
    motion = PartMotion(parts.centers, np.tile([8.0, 0.0, 0.0], (parts.count, 1)), radii)
    passed = passed_between(GRID, parts, displacements, radii)
    middle = ahead(8.0 * 0.075)

    def holds(motion: PartMotion) -> bool:
        found = cover(occupancy, motion=motion)
        then = (found.kinds == ObstacleKind.MOVING) & (found.valid_from == 83_000_000)
        inside = np.abs(found.positions[then] - middle) <= found.sizes[then] / 2
        return bool(inside.all(axis=1).any())

    assert not holds(motion)
    assert holds(replace(motion, between=passed))
