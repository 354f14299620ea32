"""What may be in unseen space: hands hang on arms, loose things come to rest, and what was seen empty stays empty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast.bits import Bits
from twin_node.forecast.hiding import HidingPlaces, Memory, Seen, follow, follow_reference
from twin_node.forecast.kernels import kernels
from twin_node.scene import Bool, Grid

GRID = Grid(np.zeros(3), 0.02, (40, 40, 30))
STEP_NS = 33_000_000
SHADOW = (slice(14, 24), slice(14, 24), slice(8, 18))
"""A place in the middle that touches no side."""


def mask(*boxes: tuple[slice, slice, slice]) -> Bool:
    dense = np.zeros(GRID.dims, np.bool_)
    for box in boxes:
        dense[box] = True
    return dense.reshape(-1)


NOTHING = mask()


@dataclass(frozen=True)
class Found:
    """`Hidden` as flat masks [GRID.size]."""

    reachable: Bool
    maybe_full: Bool


class Watch:
    """Plays masks into the hiding places at camera rate."""

    def __init__(self) -> None:
        self.places = HidingPlaces(GRID)
        self.stamp = 0

    def see(self, unknown: Bool, moving: Bool = NOTHING, standing: Bool = NOTHING, after_ns: int = STEP_NS) -> Found:
        self.stamp += after_ns
        masks = (Bits.of_mask(GRID.dims, one) for one in (unknown & ~moving & ~standing, moving, standing))
        hidden = self.places.update(self.stamp, *masks)
        return Found(hidden.reachable.mask(), hidden.maybe_full.mask())


def test_space_never_seen_may_be_full_and_lets_nothing_out() -> None:
    found = Watch().see(mask(SHADOW))
    assert np.array_equal(found.maybe_full, mask(SHADOW))
    assert not found.reachable.any()


def test_space_seen_empty_stays_empty_in_a_shadow() -> None:
    watch = Watch()
    watch.see(NOTHING)
    found = watch.see(mask(SHADOW))
    assert not found.reachable.any() and not found.maybe_full.any()


def test_unseen_space_up_to_a_side_is_reachable() -> None:
    watch = Watch()
    watch.see(NOTHING)
    tunnel = mask((slice(0, 24), slice(14, 24), slice(8, 18)))
    for _ in range(8):
        found = watch.see(tunnel)
    assert np.array_equal(found.reachable, tunnel)


def test_a_way_thinner_than_a_hand_leads_nowhere() -> None:
    watch = Watch()
    watch.see(NOTHING)
    for _ in range(20):
        found = watch.see(mask(SHADOW, (slice(0, 14), slice(14, 24), slice(8, 9))))
        assert not found.reachable[mask(SHADOW)].any()
    for _ in range(8):
        found = watch.see(mask(SHADOW, (slice(0, 14), slice(14, 24), slice(8, 10))))
    assert found.reachable[mask(SHADOW)].all()


def test_in_voxels_that_no_two_of_fit_into_a_hand_a_way_one_wide_is_wide_enough() -> None:
    grid = Grid(np.zeros(3), 0.03, (20, 20, 16))
    tunnel = np.zeros(grid.dims, np.bool_)
    tunnel[:12, 7, 6] = True
    nothing = Bits.none(grid.dims)
    found = HidingPlaces(grid).update(STEP_NS, Bits.of_mask(grid.dims, tunnel.reshape(-1)), nothing, nothing)
    assert np.array_equal(found.reachable.mask(), tunnel.reshape(-1))


@pytest.mark.parametrize("step_ms", [33, 66, 100])
def test_a_hand_gets_on_in_a_shadow_at_a_persons_speed(step_ms: int) -> None:
    """Of a shadow that reaches the grid's side only now, the far end is not reached at once, and never late."""
    watch = Watch()
    watch.see(NOTHING)
    tunnel = (slice(0, 30), slice(14, 24), slice(8, 18))
    for step in range(1, 20):
        columns = watch.see(mask(tunnel), after_ns=step_ms * 1_000_000).reachable.reshape(GRID.dims)[tunnel].all((1, 2))
        reached_m = columns.sum() * GRID.voxel_size
        assert columns[: int(columns.sum())].all()
        assert reached_m >= min(1.6e-3 * step_ms * step, 0.6) - 1e-9
        assert reached_m <= 0.08 + step * (1.6e-3 * step_ms + 0.04)
    assert columns.all()


def test_at_first_a_hand_may_be_wherever_unseen_space_leads_to() -> None:
    tunnel = mask((slice(0, 24), slice(14, 24), slice(8, 18)))
    watch = Watch()
    assert np.array_equal(watch.see(tunnel).reachable, tunnel)
    watch.see(NOTHING)
    assert np.array_equal(watch.see(tunnel, after_ns=600_000_000).reachable, tunnel)
    sides, z = ((slice(8, 12), slice(28, 32)), slice(8, 12))
    bent = mask((slice(0, 30), sides[0], z), (slice(26, 30), slice(8, 32), z), (slice(6, 30), sides[1], z))
    watch.see(NOTHING)
    assert np.array_equal(watch.see(bent, after_ns=600_000_000).reachable, bent)  # farther than people get meanwhile


def test_what_stands_closes_the_way() -> None:
    watch = Watch()
    tunnel = mask((slice(0, 24), slice(14, 24), slice(8, 18)))
    wall = mask((slice(6, 8), slice(10, 28), slice(4, 22)))
    found = watch.see(tunnel, standing=wall)
    inside = tunnel & mask((slice(8, 40), slice(0, 40), slice(0, 30)))
    assert not found.reachable[inside].any() and found.maybe_full[inside].all()


def test_what_went_into_a_shadow_and_hangs_on_nothing_stays_there() -> None:
    watch = Watch()
    watch.see(NOTHING)
    ball = mask((slice(10, 13), slice(17, 20), slice(11, 14)))
    assert not watch.see(mask(SHADOW)).maybe_full.any()
    assert watch.see(mask(SHADOW), moving=ball).reachable[mask(SHADOW)].any()
    for _ in range(8):
        found = watch.see(mask(SHADOW))
        assert found.reachable.any()  # whose arm it is may have been missed
    assert found.reachable[mask(SHADOW)].all()
    for _ in range(4):
        found = watch.see(mask(SHADOW))
    assert not found.reachable.any()
    assert np.array_equal(found.maybe_full, mask(SHADOW))


def test_a_hand_that_is_still_seen_to_reach_in_may_always_come_out() -> None:
    watch = Watch()
    watch.see(NOTHING)
    forearm = mask((slice(0, 14), slice(17, 21), slice(11, 15)))
    for _ in range(90):
        found = watch.see(mask(SHADOW), moving=forearm)
    assert found.reachable[mask(SHADOW)].all()


def test_a_thing_faster_than_the_cameras_is_not_missed_on_its_way() -> None:
    watch = Watch()
    watch.see(NOTHING)
    near = mask((slice(11, 13), slice(17, 20), slice(11, 14)))
    watch.see(NOTHING, moving=near)
    assert watch.see(mask(SHADOW)).reachable.any()


@pytest.mark.parametrize("is_from_x", [True, False])
@pytest.mark.parametrize(
    ("stone", "is_reached"),
    [
        ([(slice(16, 18), slice(10, 12))], False),
        ([(slice(16, 22), slice(10, 16))], True),
        ([(slice(12, 24), slice(10, 12))], True),  # long and narrow
        ([(slice(16, 20), slice(10, 12)), (slice(20, 24), slice(12, 16))], True),  # of two that touch at an edge
        ([(slice(16, 18), slice(10, 16)), (slice(18, 20), slice(20, 26))], False),  # two that do not
    ],
)
def test_specks_are_no_stepping_stones_for_a_hand(
    stone: list[tuple[slice, slice]], is_reached: bool, is_from_x: bool
) -> None:
    """From the grid's side to a shadow by places in between, each too far from the next but one to be passed over."""
    watch = Watch()
    watch.see(NOTHING)
    stones = mask(*((slice(x, x + 2), *part) for x in (4, 8, 12) for part in stone)).reshape(GRID.dims)
    stones = (stones if is_from_x else stones.swapaxes(0, 1)).reshape(-1)
    for _ in range(4):
        found = watch.see(stones | mask(SHADOW), after_ns=50_000_000)
    assert found.reachable[mask(SHADOW)].any() == is_reached


@pytest.mark.parametrize(("gap", "step_ms", "is_reached"), [(2, 150, True), (2, 33, True), (6, 150, False)])
def test_a_hand_comes_across_no_wide_space_that_is_seen_to_be_empty(gap: int, step_ms: int, is_reached: bool) -> None:
    """Whatever the time between two sets: the forearm that it hangs on would be seen there."""
    watch = Watch()
    watch.see(NOTHING)
    body = mask((slice(0, 14 - gap), slice(8, 30), slice(4, 22)))
    for _ in range(4):
        found = watch.see(mask(SHADOW), moving=body, after_ns=step_ms * 1_000_000)
        assert found.reachable[mask(SHADOW)].any() == is_reached


def test_after_a_pause_nothing_is_known_to_be_empty() -> None:
    watch = Watch()
    watch.see(NOTHING)
    found = watch.see(mask(SHADOW), after_ns=2_000_000_000)
    assert (found.reachable | found.maybe_full)[mask(SHADOW)].all()


def test_nothing_comes_through_the_table() -> None:
    watch = Watch()
    watch.see(NOTHING)
    assert not watch.see(mask((slice(14, 24), slice(14, 24), slice(0, 12)))).reachable.any()


def random_mask(grid: Grid, rng: np.random.Generator, boxes: int, noise: float) -> Bool:
    dense = rng.uniform(size=grid.dims) < noise
    for _ in range(boxes):
        start = rng.integers(0, grid.dims)
        stop = start + rng.integers(1, 20, 3)
        dense[tuple(slice(a, b) for a, b in zip(start, stop, strict=True))] = True
    return dense.reshape(-1)


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    dims=st.tuples(st.integers(1, 30), st.integers(1, 30), st.integers(1, 140)),
    voxel_size=st.sampled_from([0.012, 0.02, 0.05]),
)
def test_compiled_hiding_places_are_the_plain_ones(seed: int, dims: tuple[int, int, int], voxel_size: float) -> None:
    rng = np.random.default_rng(seed)
    grid = Grid(np.zeros(3), voxel_size, dims)
    compiled, plain = Memory.of_nothing(grid), Memory.of_nothing(grid)
    for elapsed_s in (0.0, 0.033, 0.4, 0.1, 0.2, 2.0):
        masks = [random_mask(grid, rng, *bounds) for bounds in ((4, 0.3), (1, 0.002), (2, 0.01))]
        masks[0] &= ~masks[1] & ~masks[2]
        seen = Seen(elapsed_s, *(Bits.of_mask(dims, one) for one in masks))
        assert np.array_equal(follow(grid, compiled, seen).words, follow_reference(grid, plain, seen).words)
        assert np.array_equal(compiled.ages_s, plain.ages_s)
        assert np.array_equal(compiled.reached.words, plain.reached.words)
        assert np.array_equal(compiled.maybe_full.words, plain.maybe_full.words)
