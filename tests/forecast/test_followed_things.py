"""What is followed as a whole, by its size, its place and its pace, and how surely its motion is told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID

from twin_node.forecast.parts import Parts, split
from twin_node.forecast.things import Things, Whole, pieces_of, pieces_of_reference
from twin_node.scene import Float64

CAMERAS = ("left", "right")
STEP_NS = 20_000_000
Voxel = tuple[int, int, int]


def box(first: Voxel, sides: Voxel, besides: int = 0) -> Parts:
    """A box of voxels, and so many more of them in a row at its far end."""
    mask = np.zeros(GRID.dims, np.bool_)
    mask[tuple(slice(start, start + side) for start, side in zip(first, sides, strict=True))] = True
    mask[first[0] + sides[0] : first[0] + sides[0] + besides, first[1], first[2]] = True
    indices = np.flatnonzero(mask)
    return split(GRID, indices, np.ones(len(indices), np.bool_))


def followed(before: Parts, after: Parts, begun: int = 0, step_ns: int = STEP_NS) -> Whole:
    """What is told of the second set, of a thing that the first one shows."""
    things = Things(GRID)
    things.follow(begun, CAMERAS, before)
    return things.follow(begun + step_ns, CAMERAS, after)


@pytest.mark.parametrize(("length", "is_followed"), [(14, True), (16, False)])
@pytest.mark.parametrize("axis", range(3))
def test_what_is_longer_than_45_cm_is_not_followed_however_thin_it_is(
    axis: int, length: int, is_followed: bool
) -> None:
    sides = [2, 2, 2]
    sides[axis] = length
    rod = box((6, 6, 6), (sides[0], sides[1], sides[2]))
    assert followed(rod, rod).followed.tolist() == [is_followed] * rod.count


@pytest.mark.parametrize(
    ("first", "is_followed"),
    [
        ((1, 10, 10), True),
        ((0, 10, 10), False),
        ((10, 0, 10), False),
        ((10, 10, 0), True),
        ((37, 10, 10), True),
        ((38, 10, 10), False),
        ((10, 38, 10), False),
        ((10, 10, 28), False),
    ],
)
def test_what_is_cut_off_by_a_side_of_the_grid_or_its_top_is_not_followed(first: Voxel, is_followed: bool) -> None:
    cube = box(first, (2, 2, 2))
    assert followed(cube, cube).followed.all() == is_followed


@pytest.mark.parametrize(("voxels", "is_followed"), [(4, True), (3, False)])
def test_fewer_than_four_voxels_are_no_thing(voxels: int, is_followed: bool) -> None:
    thing = box((10, 10, 10), (voxels, 1, 1))
    assert followed(thing, thing).followed.all() == is_followed


@pytest.mark.parametrize(("besides", "is_followed"), [(4, True), (5, False)])
def test_a_thing_is_not_taken_for_another_of_more_than_one_and_a_half_times_its_volume(
    besides: int, is_followed: bool
) -> None:
    small, large = box((10, 10, 10), (2, 2, 2)), box((10, 10, 10), (2, 2, 2), besides)
    assert followed(small, large).followed.all() == is_followed
    assert followed(large, small).followed.all() == is_followed


@pytest.mark.parametrize(("voxels", "is_followed"), [(9, True), (11, False)])
def test_nothing_is_followed_that_goes_faster_than_a_throw(voxels: int, is_followed: bool) -> None:
    """13.5 and 16.5 m/s."""
    whole = followed(box((10, 10, 10), (2, 2, 2)), box((10 + voxels, 10, 10), (2, 2, 2)))
    assert whole.followed.all() == is_followed


@pytest.mark.parametrize("begun", [0, 1_700_000_000_000_000_000])
def test_velocities_are_told_by_what_passes_between_two_sets_whenever_that_is(begun: int) -> None:
    whole = followed(box((10, 10, 10), (2, 2, 2)), box((12, 10, 10), (2, 2, 2)), begun, 40_000_000)
    assert whole.velocities == pytest.approx(np.tile([1.5, 0.0, 0.0], (len(whole.velocities), 1)), abs=0.01)
    flying = followed(box((10, 10, 10), (2, 2, 2)), box((16, 10, 10), (2, 2, 2)), begun, 40_000_000)
    assert flying.flying.all() and not whole.flying.any()
    for sigmas in (whole.sigmas, flying.sigmas):
        assert sigmas == pytest.approx(np.sqrt(2) * GRID.voxel_size / 2 / 0.04, rel=0.01), "half a voxel each time"


def test_of_two_alike_the_one_where_its_velocity_led_is_the_thing_of_before() -> None:
    """The other, which came from elsewhere, is nearer to where that was."""
    things, mask = Things(GRID), np.zeros(GRID.dims, np.bool_)
    mask[18:20, 10:12, 10:12] = mask[13:15, 13:15, 10:12] = True
    indices = np.flatnonzero(mask)
    both = split(GRID, indices, np.ones(len(indices), np.bool_))
    for tick, parts in enumerate((box((10, 10, 10), (2, 2, 2)), box((14, 10, 10), (2, 2, 2)), both)):
        whole = things.follow(tick * STEP_NS, CAMERAS, parts)
    is_ahead = both.centers[:, 0] > GRID.origin[0] + 16 * GRID.voxel_size
    assert 0 < is_ahead.sum() < both.count
    assert np.array_equal(whole.followed, is_ahead)
    assert whole.velocities[is_ahead, 0] == pytest.approx(6.0, abs=0.1)


def test_of_what_is_seen_to_grow_or_to_shrink_less_is_known_than_of_what_stays_as_it_is() -> None:
    """By how much its middle may have moved for that: a share of its length."""
    small, large = box((10, 10, 10), (2, 2, 2)), box((10, 10, 10), (2, 2, 2), 3)
    same, grown, shrunk = (followed(*pair).sigmas.max() for pair in ((small, small), (small, large), (large, small)))
    assert same < shrunk < grown < 2 * same
    long, longer = box((10, 10, 10), (8, 1, 1)), box((10, 10, 10), (8, 1, 1), 3)
    assert 1.2 * grown < followed(long, longer).sigmas.max() < 3 * same


def test_what_is_known_half_as_well_is_trusted_a_quarter_as_much_and_what_is_not_followed_not_at_all() -> None:
    cube = box((10, 10, 10), (2, 2, 2))
    whole = followed(cube, cube)
    assert (whole.trusts > 0).all()
    assert replace(whole, sigmas=2 * whole.sigmas).trusts == pytest.approx(whole.trusts / 4)
    assert not Whole.none(2).trusts.any()


@pytest.mark.parametrize(("apart_m", "pieces"), [(0.12, 1), (0.135, 2)])
@pytest.mark.parametrize("find", [pieces_of, pieces_of_reference])
def test_parts_are_of_one_thing_where_they_are_neighbours_if_only_across_an_edge(
    find: Callable[[Float64], np.ndarray], apart_m: float, pieces: int
) -> None:
    places = np.array([[0.0, 0.0, 0.0], [0.0, apart_m, 0.0], [0.0, 2 * apart_m, 0.0]])
    assert len(set(find(places[:2]).tolist())) == pieces
    assert len(set(find(places).tolist())) == 2 * pieces - 1, "as a chain"


def test_how_high_a_part_is_above_the_lowest_of_its_thing_is_told() -> None:
    tall = box((10, 10, 7), (2, 2, 9))
    whole = followed(tall, tall)
    assert tall.count > 2
    assert tall.centers[:, 2] - whole.above == pytest.approx(GRID.origin[2] + 7 * GRID.voxel_size)
