"""The cover: every occupied voxel inside an obstacle for as long as it is occupied, under any cap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast import CoverParameters, ForecastError, PartMotion, cover
from twin_node.forecast.bits import Bits
from twin_node.forecast.bound import PERSON_SPEED
from twin_node.forecast.grid import encode_runs
from twin_node.forecast.hiding import Hidden
from twin_node.forecast.sighting import Sighted, Spreading
from twin_node.scene import (
    HORIZONS_NS,
    Bool,
    Float64,
    Grid,
    MotionExpert,
    ObstacleKind,
    Obstacles,
    Occupancy,
    OccupancyLayer,
)

GRID = Grid(np.array([-0.5, 0.25, 0.0]), 0.02, (31, 26, 40))


def layer(horizon: int, indices: np.ndarray) -> OccupancyLayer:
    chosen = np.unique(indices).astype(np.uint32)
    return OccupancyLayer(horizon, chosen, np.full(len(chosen), 200, np.uint8))


def spreading(grid: Grid, indices: np.ndarray) -> Spreading:
    """Voxels as one group that gets 5 cm far and goes on at 0.4 m/s."""
    places = np.stack(np.unravel_index(indices, grid.dims), axis=1).reshape(-1, 3)
    corners = (places.min(axis=0, initial=10**6)[None], places.max(axis=0, initial=-1)[None])
    return Spreading((indices,), *corners, np.array([0.05]), np.array([0.4]))


def sighted(grid: Grid, indices: np.ndarray) -> Sighted:
    """Voxels that were seen, without rims, 0.1 s before forecasts begin."""
    return Sighted(grid, spreading(grid, indices), spreading(grid, indices[:0]), 0.1)


def occupancy(blobs: Float64, static: np.ndarray, unknown: Bool | None = None) -> Occupancy:
    """Layers with a ball about one of `blobs` [5, 3] each, m."""
    centers = GRID.centers(np.arange(GRID.size))
    layers = tuple(
        layer(horizon, np.flatnonzero(np.linalg.norm(centers - blob, axis=1) < 0.08))
        for horizon, blob in zip(HORIZONS_NS, blobs, strict=True)
    )
    runs = encode_runs(np.zeros(GRID.size, np.bool_) if unknown is None else unknown)
    return Occupancy(1_000, 33_000_000, GRID, layers, layer(0, static), runs)


def held(obstacles: Obstacles, indices: np.ndarray, stamp: int, kind: ObstacleKind) -> Bool:
    """Whether all eight corners of each voxel lie in one obstacle of the kind that is valid at the stamp."""
    inside = np.zeros(len(indices), np.bool_)
    valid = (obstacles.valid_from <= stamp) & (obstacles.valid_to >= stamp) & (obstacles.kinds == kind)
    for row in np.flatnonzero(valid):
        offset = np.abs(GRID.centers(indices) - obstacles.positions[row]) + GRID.voxel_size / 2
        inside |= np.all(offset <= obstacles.sizes[row] / 2 + 1e-9, axis=1)
    return inside


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    most_moving=st.integers(1, 40),
    most_static=st.integers(1, 40),
    scattered=st.integers(0, 300),
)
def test_every_occupied_voxel_is_held_over_its_interval(
    seed: int, most_moving: int, most_static: int, scattered: int
) -> None:
    rng = np.random.default_rng(seed)
    blobs = GRID.origin + rng.uniform(0, 1, (5, 3)) * np.array(GRID.dims) * GRID.voxel_size
    found = occupancy(blobs, rng.integers(0, GRID.size, scattered))
    obstacles = cover(found, None, CoverParameters(most_moving=most_moving, most_static=most_static))
    for index, horizon in enumerate(HORIZONS_NS):
        indices = found.layers[index].indices.astype(np.int64)
        for earlier in HORIZONS_NS[max(index - 1, 0) : index + 2]:
            middle = found.publish_stamp + (horizon + earlier) // 2
            assert held(obstacles, indices, middle, ObstacleKind.MOVING).all()
    last = found.publish_stamp + HORIZONS_NS[-1]
    assert held(obstacles, found.static.indices.astype(np.int64), last, ObstacleKind.STATIC).all()
    moving = obstacles.kinds == ObstacleKind.MOVING
    assert np.unique(obstacles.valid_from[moving], return_counts=True)[1].max(initial=0) <= most_moving
    assert np.count_nonzero(obstacles.kinds == ObstacleKind.STATIC) <= most_static
    assert len(np.unique(obstacles.ids)) == len(obstacles.ids)


def test_nothing_occupied_gives_no_obstacles() -> None:
    far = np.full((5, 3), 100.0)
    assert len(cover(occupancy(far, np.zeros(0, np.int64))).ids) == 0


def test_ids_stay_under_small_motion() -> None:
    start = np.tile([-0.2, 0.5, 0.4], (5, 1))
    first = cover(occupancy(start, np.zeros(0, np.int64)))
    second = cover(occupancy(start + 0.01, np.zeros(0, np.int64)), first)
    shared = np.intersect1d(first.ids, second.ids)
    assert len(shared) >= 0.6 * len(first.ids)
    for one in shared:
        moved = first.positions[first.ids == one] - second.positions[second.ids == one]
        assert np.linalg.norm(moved) < 0.05


def test_unknown_space_becomes_few_coarse_boxes() -> None:
    unknown = np.zeros(GRID.dims, np.bool_)
    unknown[:16, :16, :32] = True
    obstacles = cover(
        occupancy(np.full((5, 3), 100.0), np.zeros(0, np.int64), unknown.ravel()),
        None,
        CoverParameters(most_unknown=8),
    )
    assert (obstacles.kinds == ObstacleKind.UNKNOWN).all()
    assert 1 <= len(obstacles.ids) <= 8
    middle = GRID.indices(GRID.origin + np.array([[0.16, 0.16, 0.3]]))
    assert held(obstacles, middle, 40_000_000, ObstacleKind.UNKNOWN).all()


def test_unknown_space_is_an_obstacle_by_what_may_be_in_it() -> None:
    reachable, maybe_full, empty = np.zeros((3, *GRID.dims), np.bool_)
    reachable[:8, :8, :8] = maybe_full[:8, 16:24, :8] = empty[16:24, :8, :8] = True
    unknown = (reachable | maybe_full | empty).ravel()
    found = occupancy(np.full((5, 3), 100.0), np.zeros(0, np.int64), unknown)
    obstacles = cover(
        found, None, None, None, Hidden(*(Bits.of_mask(GRID.dims, mask) for mask in (reachable, maybe_full)))
    )
    for mask, kind in ((reachable, ObstacleKind.UNKNOWN), (maybe_full, ObstacleKind.UNSEEN)):
        assert held(obstacles, np.flatnonzero(mask), 40_000_000, kind).all()
    for kind in ObstacleKind:
        assert not held(obstacles, np.flatnonzero(empty), 40_000_000, kind).any()


def together(one: Occupancy, other: Occupancy) -> Occupancy:
    """What moves in both."""
    pairs = zip(one.layers, other.layers, strict=True)
    layers = (layer(mine.horizon_ns, np.concatenate([mine.indices, theirs.indices])) for mine, theirs in pairs)
    return replace(one, layers=tuple(layers))


def test_motion_gives_velocity_bound_and_expert() -> None:
    blobs = np.tile([-0.2, 0.5, 0.4], (5, 1))
    motion = PartMotion(
        blobs[:1], np.array([[0.5, 0.0, 0.0]]), np.full((5, 1), 0.06), np.array([MotionExpert.DAMPED], np.uint8)
    )
    obstacles = cover(occupancy(blobs, np.array([0])), None, None, motion)
    moving = obstacles.kinds == ObstacleKind.MOVING
    assert np.allclose(obstacles.velocities[moving], [0.5, 0, 0])
    assert np.allclose(obstacles.bounds[moving], 0.06)
    assert obstacles.experts is not None and (obstacles.experts[moving] == MotionExpert.DAMPED).all()
    assert (obstacles.experts[~moving] == MotionExpert.NO_EXPERT).all()
    assert np.allclose(obstacles.velocities[~moving], 0)


def test_each_of_two_things_has_its_own_velocity_bound_and_expert() -> None:
    places = np.array([[-0.4, 0.35, 0.2], [-0.1, 0.65, 0.6]])
    both = together(*(occupancy(np.tile(place, (5, 1)), np.array([0])) for place in places))
    velocities, experts = np.array([[0.5, 0, 0], [0, -0.3, 0]]), np.array([1, 2], np.uint8)
    found = cover(both, motion=PartMotion(places, velocities, np.tile([0.03, 0.06], (5, 1)), experts))
    moving = found.kinds == ObstacleKind.MOVING
    whose = np.linalg.norm(found.positions[moving, None] - places, axis=-1).argmin(axis=1)
    assert set(whose) == {0, 1}
    np.testing.assert_array_equal(found.velocities[moving], velocities[whose])
    np.testing.assert_array_equal(found.bounds[moving], np.array([0.03, 0.06])[whose])
    assert found.experts is not None
    np.testing.assert_array_equal(found.experts[moving], experts[whose])
    assert (found.quats == [1, 0, 0, 0]).all()


THROWN, AT_REST = np.array([-0.42, 0.35, 0.2]), np.array([0.0, 0.35, 0.45])
SPEED = 2.5
PASSING = PartMotion(
    np.stack([THROWN, AT_REST]),
    np.array([[SPEED, 0, 0], [0, 0, 0]]),
    np.zeros((5, 2)),
    displacements=np.stack([[[SPEED * horizon * 1e-9, 0, 0], [0, 0, 0]] for horizon in HORIZONS_NS]),
)
"""A ball that flies to below somebody at rest."""


def passing() -> Occupancy:
    assert PASSING.displacements is not None
    nothing = np.zeros(0, np.int64)
    return together(
        occupancy(THROWN + PASSING.displacements[:, 0], nothing), occupancy(np.tile(AT_REST, (5, 1)), nothing)
    )


def test_what_flies_past_somebody_at_rest_is_as_fast_there_as_here() -> None:
    """Its obstacles had the velocity of whoever is now nearest to where it will be: growth at 1.6 m/s for 2.5."""
    now = passing().layers[0].indices.astype(np.int64)
    found = cover(passing(), motion=PASSING, sighted=sighted(GRID, now))
    flies = found.positions[:, 2] < 0.33
    for rows in (found.as_seen, ~found.as_seen):
        assert flies[rows].any() and not flies[rows].all()
    np.testing.assert_array_equal(found.velocities[flies], np.tile([SPEED, 0, 0], (flies.sum(), 1)))
    assert not found.velocities[~flies].any()


def test_an_obstacle_that_holds_several_is_as_fast_as_the_fastest() -> None:
    """It had the velocity of the one nearest to its middle."""
    motion, one_each = PASSING, CoverParameters(most_moving=1, most_seen=1)
    seen = np.concatenate([one.indices for one in passing().layers]).astype(np.int64)
    found = cover(passing(), None, one_each, motion, sighted=sighted(GRID, seen))
    assert len(found.ids) == len(HORIZONS_NS)
    np.testing.assert_array_equal(found.velocities, np.tile([SPEED, 0, 0], (len(found.ids), 1)))


def test_obstacles_of_what_is_cut_short_are_those_of_before_where_they_are_nearly_as_good() -> None:
    rng, dense = np.random.default_rng(3), np.zeros(GRID.dims, np.bool_)
    for start in rng.integers(0, GRID.dims, (10, 3)):
        dense[tuple(slice(first, first + side) for first, side in zip(start, rng.integers(1, 12, 3), strict=True))] = 1
    far, few = np.full((5, 3), 100.0), CoverParameters(most_static=12)
    first = cover(occupancy(far, np.flatnonzero(dense)), None, few)
    dense[:3] = False
    kept, anew = (cover(occupancy(far, np.flatnonzero(dense)), before, few) for before in (first, None))
    assert np.isin(kept.ids, first.ids).mean() > np.isin(anew.ids, first.ids).mean()


def test_bounds_are_those_inside_the_shapes() -> None:
    """An obstacle of an interval is as wide as the forecast at its end; what was seen is no forecast."""
    blobs = np.tile([-0.2, 0.5, 0.4], (5, 1))
    radii = np.array([[0.01], [0.03], [0.06], [0.1], [0.15]])
    motion = PartMotion(blobs[:1], np.zeros((1, 3)), radii, np.array([MotionExpert.DAMPED], np.uint8))
    nothing = np.zeros(0, np.int64)
    obstacles = cover(occupancy(blobs, nothing), motion=motion, sighted=sighted(GRID, np.array([7, 8])))
    seen = obstacles.as_seen
    assert seen.any()
    moving = (obstacles.kinds == ObstacleKind.MOVING) & ~seen
    interval = (obstacles.valid_from[moving] - obstacles.begins) // 50_000_000
    assert np.allclose(obstacles.bounds[moving], radii[interval + 1, 0])
    assert (obstacles.bounds[seen] == 0).all()
    assert obstacles.experts is not None and (obstacles.experts[seen] == MotionExpert.NO_EXPERT).all()
    assert (obstacles.experts[moving] == MotionExpert.DAMPED).all()


def test_a_speed_beyond_a_persons_is_told_only_as_far_as_it_is_sure() -> None:
    blobs = np.tile([-0.2, 0.5, 0.4], (5, 1))
    told = []
    for speed, sigma in ((3.0, 0.5), (3.0, 2.0), (1.2, 2.0), (0.0, 2.0)):
        motion = PartMotion(blobs[:1], np.array([[speed, 0, 0]]), np.zeros((5, 1)), sigmas=np.array([sigma]))
        obstacles = cover(occupancy(blobs, np.array([0])), None, None, motion)
        told.append(float(obstacles.velocities[obstacles.kinds == ObstacleKind.MOVING][0, 0]))
    assert np.allclose(told, [2.0, PERSON_SPEED, 1.2, 0.0])


def test_of_what_leaves_the_workspace_it_is_told_where_it_was_seen() -> None:
    """Its later layers are empty."""
    blobs = np.full((5, 3), 100.0)
    blobs[:2] = [-0.2, 0.5, 0.4]
    nothing = np.zeros(0, np.int64)
    assert cover(occupancy(blobs, nothing), sighted=sighted(GRID, np.array([7, 8]))).as_seen.any()


def test_of_all_kinds_together_there_are_no_more_than_the_caps_add_up_to() -> None:
    """A checker has room for so many."""
    all_of_it = np.arange(GRID.size)
    caps = CoverParameters(most_moving=1, most_seen=1, most_static=1, most_unknown=1)
    seen = Sighted(GRID, spreading(GRID, all_of_it), spreading(GRID, all_of_it), 0.1)
    found = occupancy(np.tile([-0.2, 0.5, 0.4], (5, 1)), all_of_it)
    everywhere = Bits.of_mask(GRID.dims, np.ones(GRID.size, np.bool_))
    assert len(cover(found, None, caps, None, Hidden(everywhere, everywhere), seen).ids) == caps.most


def test_what_gets_no_farther_all_along_is_told_so_and_not_that_nobody_knows() -> None:
    """A reach of 0 m/s means the latter: the law would take a person's speed instead."""
    blobs, seen_at = np.tile([-0.2, 0.5, 0.4], (5, 1)), np.array([7, 8])
    still = replace(spreading(GRID, seen_at), speeds=np.zeros(1))
    seen = Sighted(GRID, still, spreading(GRID, seen_at[:0]), 0.1)
    obstacles = cover(occupancy(blobs, np.zeros(0, np.int64)), sighted=seen)
    assert obstacles.reach_speeds is not None and obstacles.reach_delays is not None
    speed, delay = obstacles.reach_speeds[obstacles.as_seen], obstacles.reach_delays[obstacles.as_seen]
    assert (speed > 0).all() and np.isfinite(delay).all()
    assert np.allclose(speed * (0.3 - delay), 0.05, atol=1e-3)


def test_cap_below_one_is_refused() -> None:
    with pytest.raises(ForecastError, match="most_moving"):
        cover(occupancy(np.full((5, 3), 100.0), np.zeros(0, np.int64)), None, CoverParameters(most_moving=0))


def test_what_was_seen_is_held_at_the_evidence() -> None:
    wide = Grid(GRID.origin - 0.2, 0.02, (51, 46, 50))
    body = np.linalg.norm(wide.centers(np.arange(wide.size)) - GRID.origin, axis=1) < 0.15  # half of it outside
    blobs = np.tile(GRID.origin + 0.1, (5, 1))
    nothing = np.zeros(0, np.int64)
    forecast = cover(occupancy(blobs, nothing))
    obstacles = cover(occupancy(blobs, nothing), sighted=sighted(wide, np.flatnonzero(body)))
    seen = obstacles.as_seen
    assert 0 < seen.sum() <= CoverParameters().most_seen
    assert obstacles.reach_speeds is not None and obstacles.reach_delays is not None
    assert np.allclose(obstacles.reach_speeds[seen], 0.4)
    assert np.allclose(0.4 * (0.1 - obstacles.reach_delays[seen]), 0.05)
    assert (obstacles.reach_speeds[~seen] == 0).all()
    assert not forecast.as_seen.any()
    assert len(forecast.ids) == len(obstacles.ids) - seen.sum()
    assert len(np.unique(obstacles.ids)) == len(obstacles.ids)
    assert (obstacles.valid_from[seen] == obstacles.stamp).all()
    assert obstacles.begins == forecast.begins == 33_000_000
    points = wide.centers(np.flatnonzero(body))
    gaps = np.abs(points[:, None] - obstacles.positions[seen]) + wide.voxel_size / 2 - obstacles.sizes[seen] / 2
    assert (gaps.max(axis=2) <= 1e-9).any(axis=1).all()
    far = np.full((5, 3), 100.0)
    assert len(cover(occupancy(far, nothing), sighted=sighted(wide, np.flatnonzero(body))).ids) == 0
    assert cover(occupancy(far, nothing)).begins == 1_000


@pytest.mark.parametrize("horizons", [(), (0,), (0, 0), (100_000_000, 0), tuple(range(8))])
def test_layers_between_which_nothing_would_be_valid_are_refused(horizons: tuple[int, ...]) -> None:
    """Of one layer alone nothing that moves was in any obstacle, without a word."""
    none = np.zeros(0, np.int64)
    moving = replace(
        occupancy(np.zeros((5, 3)), none), layers=tuple(layer(horizon, np.arange(40)) for horizon in horizons)
    )
    with pytest.raises(ForecastError, match="cover: expected 2 to 7 layers in the order of their horizons, found"):
        cover(moving)
