"""What moved and stands now may start again: people who keep still, not the furniture about them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID, ball_voxels, state_of

from twin_node.forecast import Forecaster, ForecastResult
from twin_node.forecast.bits import Bits
from twin_node.forecast.kernels import kernels
from twin_node.forecast.resting import RESTING_S, Memory, Resting, rested, rested_reference
from twin_node.scene import Grid, Occupancy, TwinState

STEP_NS = 33_333_333
LATENCY_NS = 33_000_000
PERSON_M, BALL_M = 0.28, 0.1
"""Radii of a body too large to be followed as a whole, and of one that is not."""
COARSE = Grid(np.zeros(3), 0.05, (40, 8, 8))
"""A hand fits into each voxel."""
FINE = Grid(np.zeros(3), 0.02, (40, 20, 20))


def standing(*voxels: int) -> Bits:
    return Bits.of_indices(COARSE.dims, np.array(voxels))


def block(start: tuple[int, int, int], *sides: int) -> np.ndarray:
    """Flat indices in the fine grid."""
    mask = np.zeros(FINE.dims, np.bool_)
    mask[tuple(slice(first, first + side) for first, side in zip(start, sides, strict=True))] = True
    return np.flatnonzero(mask)


def test_what_stands_where_something_moved_is_resting_for_20_s() -> None:
    resting, nothing = Resting(COARSE), np.zeros(0, np.int64)
    assert resting.update(0, np.array([5, 6]), standing(7)).tolist() == []
    assert resting.update(STEP_NS, nothing, standing(5, 7)).tolist() == [5]
    almost = 20_000_000_000 - 1
    assert resting.update(almost, nothing, standing(5, 7)).tolist() == [5]
    assert resting.update(almost + 1, nothing, standing(5, 7)).tolist() == []
    assert resting.update(almost + 2, np.array([5]), standing(7)).tolist() == []
    assert resting.update(almost + 3, nothing, standing(5, 7)).tolist() == [5]


def test_what_stood_all_along_is_none_though_something_passed_over_it() -> None:
    resting, nothing = Resting(COARSE), np.zeros(0, np.int64)
    resting.update(0, np.array([5, 6]), standing(5))
    assert resting.update(STEP_NS, nothing, standing(5)).tolist() == []


def test_an_edge_of_furniture_that_is_found_after_something_passed_it_is_none_either() -> None:
    resting, nothing = Resting(COARSE), np.zeros(0, np.int64)
    resting.update(0, np.array([5, 6]), standing(4))
    assert resting.update(STEP_NS, nothing, standing(4, 5)).tolist() == [], "5 alone is a layer about 4"


def test_a_body_that_rests_on_furniture_is_all_of_it() -> None:
    resting, nothing = Resting(COARSE), np.zeros(0, np.int64)
    resting.update(0, np.array([5, 6, 7]), standing(4))
    assert resting.update(STEP_NS, nothing, standing(4, 5, 6, 7)).tolist() == [5, 6, 7]
    assert resting.update(2 * STEP_NS, nothing, standing(4, 5)).tolist() == [], "it left, but for what may be an edge"


@pytest.mark.parametrize(("away", "is_limb"), [(20, True), (30, False)])
@pytest.mark.parametrize("moves", [True, False])
def test_a_layer_about_what_stood_is_somebodys_while_they_are_within_reach(
    away: int, is_limb: bool, moves: bool
) -> None:
    """A hand on a table, of somebody who moves or came to rest; the table's rim, found after somebody passed it by."""
    resting, nothing = Resting(FINE), np.zeros(0, np.int64)
    table, layer, body = block((4, 4, 4), 4, 4, 1), block((4, 4, 5), 4, 4, 1), block((4 + away, 4, 5), 2, 2, 2)
    resting.update(0, np.concatenate([layer, body]), Bits.of_indices(FINE.dims, table))
    stands = np.concatenate([table, layer, nothing if moves else body])
    found = resting.update(STEP_NS, body if moves else nothing, Bits.of_indices(FINE.dims, stands))
    assert np.isin(layer, found).all() if is_limb else not np.isin(layer, found).any(), f"{away * 0.02:.2f} m"
    assert np.isin(body, found).all() != moves


@pytest.mark.parametrize(
    ("layer", "is_limb"),
    [
        (block((4, 4, 5), 2, 4, 1), True),
        (block((4, 4, 5), 1, 6, 1), False),
        (np.concatenate([block((x, y, 5), 1, 1, 1) for x in (5, 7, 9, 11) for y in (4, 6, 8)]), False),
        (block((12, 4, 5), 1, 1, 1), True),
    ],
)
def test_voxels_of_a_layer_are_a_limb_where_they_touch_somebody_or_a_hand_fits_in(
    layer: np.ndarray, is_limb: bool
) -> None:
    """Three voxels at a tray's edge, found to stand after a hand had passed, held the arm till the end."""
    resting = Resting(FINE)
    table, body = block((4, 4, 4), 9, 6, 1), block((13, 4, 5), 2, 3, 3)
    resting.update(0, np.concatenate([layer, body]), Bits.of_indices(FINE.dims, table))
    found = resting.update(STEP_NS, body, Bits.of_indices(FINE.dims, np.concatenate([table, layer])))
    assert found.tolist() == (np.sort(layer).tolist() if is_limb else [])


@pytest.mark.parametrize("had_stood", [True, False])
def test_a_layer_that_had_stood_before_somebody_passed_over_it_is_nobodys(had_stood: bool) -> None:
    """By noise the surface of a table stands now in this layer of voxels and now in that."""
    resting, nothing = Resting(FINE), np.zeros(0, np.int64)
    table, layer, body = block((4, 4, 4), 4, 4, 1), block((4, 4, 5), 4, 4, 1), block((14, 4, 5), 2, 2, 2)
    bare, whole = (Bits.of_indices(FINE.dims, voxels) for voxels in (table, np.concatenate([table, layer])))
    resting.update(0, nothing, whole if had_stood else bare)
    resting.update(STEP_NS, nothing, bare)
    for seconds in range(0, 60, 5):  # for longer than it is remembered that something moved
        resting.update(round((seconds + 1) * 1e9), np.concatenate([layer, body]), bare)
        found = resting.update(round((seconds + 2) * 1e9), body, whole)
        assert np.isin(layer, found).all() != had_stood, f"{seconds} s"


def test_who_rests_where_a_crate_was_that_is_gone_is_somebody() -> None:
    """But for the layer on the table, which may be its surface."""
    resting, nothing = Resting(FINE), np.zeros(0, np.int64)
    table, crate = block((4, 4, 4), 4, 4, 1), block((4, 4, 5), 4, 4, 4)
    bare, laden = (Bits.of_indices(FINE.dims, voxels) for voxels in (table, np.concatenate([table, crate])))
    for tick, (moving, stands) in enumerate([(nothing, laden), (nothing, bare), (crate, bare), (nothing, laden)]):
        found = resting.update(tick * STEP_NS, moving, stands)
    assert np.array_equal(found, np.setdiff1d(crate, block((4, 4, 5), 4, 4, 1)))


@pytest.mark.parametrize("was_carried_away", [True, False])
def test_what_had_stood_is_forgotten_once_nothing_stands_there_nor_beside_it(was_carried_away: bool) -> None:
    """A hand that rests on a table that was brought where a thicker one had been is somebody's."""
    resting, nothing = Resting(FINE), np.zeros(0, np.int64)
    table, layer, body = block((4, 4, 4), 4, 4, 1), block((4, 4, 5), 4, 4, 1), block((14, 4, 5), 2, 2, 2)
    bare, thick = (Bits.of_indices(FINE.dims, voxels) for voxels in (table, np.concatenate([table, layer])))
    sets = [
        (nothing, thick),
        (nothing, Bits.none(FINE.dims) if was_carried_away else bare),
        (np.concatenate([layer, body]), bare),
        (body, thick),
    ]
    for tick, (moving, stands) in enumerate(sets):
        found = resting.update(tick * STEP_NS, moving, stands)
    assert np.isin(layer, found).all() == was_carried_away


def test_two_layers_of_a_rim_are_nobody_either() -> None:
    """Single voxels of the second one touch nothing that stood."""
    resting, nothing = Resting(FINE), np.zeros(0, np.int64)
    table, layer, speck = block((4, 4, 4), 8, 8, 1), block((4, 4, 5), 8, 8, 1), block((6, 6, 6), 1, 2, 1)
    resting.update(0, np.concatenate([layer, speck]), Bits.of_indices(FINE.dims, table))
    found = resting.update(STEP_NS, nothing, Bits.of_indices(FINE.dims, np.concatenate([table, layer, speck])))
    assert found.tolist() == []


@pytest.mark.parametrize(
    ("rests", "moves", "is_somebody"),
    [
        (block((10, 10, 10), 3, 3, 1), block((0, 0, 0), 0, 0, 0), True),
        (block((10, 10, 10), 1, 2, 3), block((0, 0, 0), 0, 0, 0), False),
        (block((10, 10, 10), 1, 2, 3), block((14, 10, 10), 2, 2, 2), True),
        (block((10, 10, 10), 1, 2, 3), block((30, 10, 10), 2, 2, 2), False),
    ],
)
def test_specks_that_nobody_left_are_nobody(rests: np.ndarray, moves: np.ndarray, is_somebody: bool) -> None:
    """In the arm's shadow six voxels of a hand that had gone stayed, and held the arm for 20 s."""
    resting = Resting(FINE)
    resting.update(0, rests, Bits.none(FINE.dims))
    found = resting.update(STEP_NS, moves, Bits.of_indices(FINE.dims, rests))
    assert found.tolist() == (rests.tolist() if is_somebody else [])


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@pytest.mark.parametrize("seed", range(5))
def test_compiled_memory_is_the_plain_one(seed: int) -> None:
    rng, grid = np.random.default_rng(seed), Grid(np.zeros(3), 0.1, (7, 5, 70))
    one, other = Memory.of_nothing(grid), Memory.of_nothing(grid)
    for tick in range(12):
        stamp, moving = tick * round(RESTING_S * 0.3e9), np.flatnonzero(rng.random(grid.size) < 0.1)
        stands = Bits.of_mask(grid.dims, rng.random(grid.size) < 0.4)
        found, plain = rested(one, stamp, moving, stands), rested_reference(other, stamp, moving, stands)
        assert np.array_equal(found, plain)
        assert np.array_equal(one.moved_at, other.moved_at)
        assert np.array_equal(one.moved.words, other.moved.words)


def comes_and_rests(radius: float, rest_s: float) -> ForecastResult:
    """A body that moves for half a second and then looks as furniture does."""
    forecaster, moving_sets = Forecaster(GRID), 15
    for tick in range(moving_sets + round(rest_s * 1e9 / STEP_NS)):
        place = np.array([-0.25 + 0.02 * min(tick, moving_sets), 0.05, 0.45])
        state: TwinState = state_of(tick * STEP_NS, place, radius, with_depth=True)
        if tick > moving_sets:
            state = replace(state, moving_masks=tuple(np.zeros_like(mask) for mask in state.moving_masks))
        found = forecaster.update(state, state.stamp + LATENCY_NS)
    return found


def held(occupancy: Occupancy, radius: float, layer: int) -> float:
    """Share of the voxels about where the body came to rest that a moving layer holds."""
    return float(np.isin(ball_voxels(np.array([0.05, 0.05, 0.45]), radius), occupancy.layers[layer].indices).mean())


def test_a_person_who_keeps_still_is_expected_to_start_again() -> None:
    found = comes_and_rests(PERSON_M, rest_s=1.5)
    layers = found.occupancy.layers
    assert len(found.motion.centers) == 0  # no part of it is seen to move
    assert held(found.occupancy, PERSON_M + 0.12, layer=-1) > 0.9
    assert len(layers[0].indices) < len(layers[-1].indices)
    assert len(found.sighted.likely.reached) > 0  # the proof by sight counts it too


def test_a_ball_that_rolled_to_rest_is_not() -> None:
    occupancy = comes_and_rests(BALL_M, rest_s=1.5).occupancy
    assert held(occupancy, BALL_M, layer=-1) == 0
