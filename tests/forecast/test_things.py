"""Small things are followed as wholes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID, ball_voxels, state_of
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast import Forecaster
from twin_node.forecast.experts import GRAVITY
from twin_node.forecast.kernels import kernels
from twin_node.forecast.parts import Parts, split
from twin_node.forecast.things import Gathered, Things, gather, gather_reference, pieces_of, pieces_of_reference
from twin_node.scene import HORIZONS_NS, Float64, Grid

PERIOD_NS = 66_000_000
CAMERAS = ("left", "right")


def balls(*middles: tuple[float, float, float], radius: float = 0.09) -> Parts:
    voxels = np.unique(np.concatenate([ball_voxels(np.array(middle), radius) for middle in middles]))
    return split(GRID, voxels, np.ones(len(voxels), np.bool_))


def test_a_ball_is_followed_however_far_it_flies_between_two_sets() -> None:
    things = Things(GRID)
    assert not things.follow(0, CAMERAS, balls((-0.4, 0.0, 0.5))).flying.any()
    whole = things.follow(PERIOD_NS, CAMERAS, balls((-0.2, 0.0, 0.44)))
    expected = np.array([0.2, 0.0, -0.06]) / (PERIOD_NS * 1e-9)
    assert np.allclose(whole.velocities, expected, atol=0.35)
    assert whole.flying.all()
    assert (whole.trusts > 0).all()


def test_two_balls_are_told_apart_by_where_they_were_going() -> None:
    things = Things(GRID)
    for number in range(3):
        along = 0.12 * number
        whole = things.follow(number * PERIOD_NS, CAMERAS, balls((-0.3 + along, -0.2, 0.5), (0.3 - along, 0.2, 0.5)))
    forth = whole.velocities[:, 0] > 0
    assert forth.any()
    assert (~forth).any()
    assert np.allclose(np.abs(whole.velocities[:, 0]), 0.12 / (PERIOD_NS * 1e-9), atol=0.4)


@pytest.mark.parametrize("later", [balls((0.0, 0.0, 0.5), radius=0.15), balls((0.3, 0.0, 0.5), (0.42, 0.0, 0.5))])
def test_what_looks_otherwise_is_not_the_same_thing(later: Parts) -> None:
    things = Things(GRID)
    things.follow(0, CAMERAS, balls((0.0, 0.0, 0.5)))
    assert not things.follow(PERIOD_NS, CAMERAS, later).trusts.any()


def test_what_is_large_or_cut_off_by_the_border_is_not_followed() -> None:
    for middle, radius in (((0.0, 0.0, 0.5), 0.3), ((float(GRID.origin[0]) + 0.02, 0.0, 0.5), 0.09)):
        things = Things(GRID)
        things.follow(0, CAMERAS, balls(middle, radius=radius))
        assert not things.follow(PERIOD_NS, CAMERAS, balls(middle, radius=radius)).trusts.any()


def test_what_lies_on_the_bottom_of_the_grid_is_followed_and_strays_about_it_do_not_make_it_large() -> None:
    things, low = Things(GRID), float(GRID.origin[2]) + 0.02
    strays = ball_voxels(np.array([0.24, 0.0, 0.05]), 0.02), ball_voxels(np.array([-0.24, 0.0, 0.05]), 0.02)
    lying = balls((0.0, 0.0, low), radius=0.16)
    indices = np.unique(np.concatenate([lying.indices, *strays]))
    for stamp in (0, PERIOD_NS):
        whole = things.follow(stamp, CAMERAS, split(GRID, indices, np.ones(len(indices), np.bool_)))
    assert whole.followed.all()


def test_sets_of_other_cameras_are_not_compared() -> None:
    things = Things(GRID)
    things.follow(0, CAMERAS, balls((0.0, 0.0, 0.5)))
    assert not things.follow(PERIOD_NS, CAMERAS[:1], balls((0.1, 0.0, 0.5))).trusts.any()


def test_nothing_at_all_is_followed_by_nothing() -> None:
    things, none = Things(GRID), split(GRID, np.zeros(0, np.int64), np.zeros(0, np.bool_))
    rims = split(
        GRID, ball_voxels(np.array([0.0, 0.0, 0.5])), np.zeros(len(ball_voxels(np.array([0.0, 0.0, 0.5]))), np.bool_)
    )
    for number, parts in enumerate((none, rims, balls((0.0, 0.0, 0.5)))):
        assert not things.follow(number * PERIOD_NS, CAMERAS, parts).trusts.any()


def test_what_is_thrown_is_expected_to_fall() -> None:
    """A ball seen for 0.2 s: its fall within 233 ms is three times its width."""
    forecaster, speed = Forecaster(GRID), np.array([2.0, 0.0, 1.0])

    def place(stamp: int) -> np.ndarray:
        seconds = stamp * 1e-9
        path: np.ndarray = np.array([-0.6, 0.0, 0.6]) + seconds * speed + seconds**2 / 2 * GRAVITY
        return path

    for number in range(4):
        stamp = number * PERIOD_NS
        state = state_of(stamp, place(stamp), radius=0.09, with_depth=True)
        occupancy = forecaster.update(state, stamp + 33_000_000).occupancy
    there = ball_voxels(place(occupancy.publish_stamp + HORIZONS_NS[-1]), 0.09)
    assert len(there) > 0
    assert np.isin(there, occupancy.layers[-1].indices).all()
    reached = np.linalg.norm(GRID.centers(np.arange(GRID.size)) - place(stamp), axis=1) < 0.09 + 0.233 * 2.5
    assert len(occupancy.layers[-1].indices) < 0.8 * np.count_nonzero(reached)


@pytest.mark.parametrize("stands", [False, True])
@pytest.mark.parametrize("rests", [True, False])
def test_what_has_come_to_rest_by_itself_may_be_a_hand_and_start_again(rests: bool, stands: bool) -> None:
    """Of a hand whose arm was hidden or stood all along each rest was taken for that of a thing: it had 5 cm, and none
    once its masks had gone and it stood."""
    forecaster, period_ns = Forecaster(GRID), 33_000_000
    for number in range(45 + 30 * stands):
        middle = np.array([-0.25 + 0.012 * min(number, 15 if rests else 44), 0.0, 0.5])
        state = state_of(number * period_ns, middle, radius=0.17, with_depth=True)
        if number >= 45:
            state = replace(state, moving_masks=tuple(np.zeros_like(mask) for mask in state.moving_masks))
        occupancy = forecaster.update(state, state.stamp + period_ns).occupancy
    ahead = middle + (0.0 if rests or stands else 0.012 * 233 / 33) * np.array([1.0, 0.0, 0.0])
    started = ball_voxels(ahead, 0.17 + 0.9 * (0.233 - 0.045))
    held = np.isin(started, occupancy.layers[-1].indices).mean()
    assert held > 0.9 if rests else held < 0.7


@pytest.mark.parametrize("later_ns", [0, 1])
def test_a_set_that_comes_twice_ends_no_flight(later_ns: int) -> None:
    """Of two of one time the later one holds, beside what was before both."""
    once, twice = Things(GRID), Things(GRID)
    for number in range(6):
        seconds, stamp = number * PERIOD_NS * 1e-9, number * PERIOD_NS
        ball = balls((-0.3 + 2.0 * seconds, 0.0, 0.45 + 1.0 * seconds - 9.81 / 2 * seconds**2))
        told, again = (things.follow(stamp, CAMERAS, ball) for things in (once, twice))
        if number == 4:
            again = twice.follow(stamp + later_ns, CAMERAS, ball)
        if number >= 4:
            assert told.falling.all() and again.falling.all()
            np.testing.assert_allclose(again.velocities, told.velocities, atol=1e-3)


def test_rims_hang_on_the_nearest_part_that_is_more() -> None:
    left, right = (ball_voxels(np.array([x, 0.0, 0.5]), 0.06) for x in (-0.24, 0.24))
    rims = ball_voxels(np.array([0.1, 0.0, 0.5]), 0.03), ball_voxels(np.array([0.0, 0.4, 0.5]), 0.03)
    indices = np.unique(np.concatenate([left, right, *rims]))
    parts = split(GRID, indices, np.isin(indices, np.concatenate([left, right])))
    labels, near = gather(parts).labels, parts.centers[:, 1] < 0.2
    assert np.array_equal(labels[near], parts.centers[near, 0] > 0)
    assert (labels[~near] == -1).all() and (~near).any()


compared = pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")


def scattered(rng: np.random.Generator, count: int) -> Float64:
    """Middles [count, 3] m, some of them as parts on a lattice are: many are the same way apart."""
    centers = rng.uniform(0, rng.choice([0.3, 1.0]), (count, 3))
    on_lattice = rng.uniform(size=count) < 0.5
    centers[on_lattice] = np.round(centers[on_lattice] / 0.08) * 0.08
    return np.asarray(centers)


@compared
@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(0, 200))
def test_compiled_pieces_are_the_plain_ones(seed: int, count: int) -> None:
    centers = scattered(np.random.default_rng(seed), count)
    found, plain = pieces_of(centers), pieces_of_reference(centers)
    assert found.dtype == plain.dtype and np.array_equal(found, plain)


@compared
@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.002, 0.02, 0.3]), st.sampled_from([0.0, 0.3, 1.0]))
def test_compiled_things_are_the_plain_ones(seed: int, share: float, likely_share: float) -> None:
    rng, grid = np.random.default_rng(seed), Grid(np.array([0.1, -0.2, 0.3]), 0.02, (31, 25, 17))
    indices = np.flatnonzero(rng.uniform(size=grid.size) < share)
    parts = split(grid, indices, rng.uniform(size=len(indices)) < likely_share)
    found, plain = gather(parts), gather_reference(parts)
    for name in Gathered.__dataclass_fields__:
        one, other = getattr(found, name), getattr(plain, name)
        assert one.dtype == other.dtype and np.array_equal(one, other), name
