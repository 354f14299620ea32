"""Colour and depth images of one exposure find each other, in any order; a depth that fails is not waited for."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.messages import Message, convert, header_stamp
from twin_node.nodes.depth_pairs import IN_VAIN, DepthPairs, EncodedView

MS = 1_000_000
PERIOD = 33 * MS
START = 1_700_000_000_000 * MS
TOLERANCE = 10 * MS
SIZE = (12, 16)


def colour(i: int) -> Message:
    return convert.raw_image("front", START + i * PERIOD, np.full((*SIZE, 3), 90, np.uint8))


def depth(i: int, late: int = 0) -> Message:
    return convert.depth_image("front", START + i * PERIOD + late, np.ones(SIZE, np.float32))


def told(views: list[EncodedView]) -> list[tuple[int, int | None]]:
    """Stamps of colour and depth, ns after the start."""
    return [(header_stamp(v.colour) - START, None if v.depth is None else header_stamp(v.depth) - START) for v in views]


@pytest.mark.parametrize("late", [-TOLERANCE, 0, TOLERANCE])
def test_whichever_comes_first_waits_for_the_other(late: int) -> None:
    pairs = DepthPairs(TOLERANCE)
    assert pairs.add_colour(colour(0)) == []
    assert told(pairs.add_depth(depth(0, late))) == [(0, late)]
    assert pairs.add_depth(depth(1, late)) == []
    assert told(pairs.add_colour(colour(1))) == [(PERIOD, PERIOD + late)]


@pytest.mark.parametrize("late", [(-9, 2), (2, -9), (9, -2), (-2, 9)])
def test_of_several_depth_images_the_nearest_is_taken(late: tuple[int, int]) -> None:
    """A depth camera faster than its colour camera."""
    pairs = DepthPairs(TOLERANCE)
    for milliseconds in late:
        pairs.add_depth(depth(1, milliseconds * MS))
    nearest = min(late, key=abs) * MS
    assert told(pairs.add_colour(colour(1))) == [(PERIOD, PERIOD + nearest)]


def test_an_image_without_depth_goes_when_the_next_depth_comes() -> None:
    pairs = DepthPairs(TOLERANCE)
    assert pairs.add_colour(colour(0)) == []
    assert pairs.add_colour(colour(1)) == []
    assert told(pairs.add_depth(depth(1))) == [(0, None), (PERIOD, PERIOD)]


def test_without_any_depth_it_goes_when_an_image_comes_that_is_two_periods_newer() -> None:
    pairs = DepthPairs(TOLERANCE)
    assert pairs.add_colour(colour(0)) == []
    assert pairs.add_colour(colour(1)) == []
    assert told(pairs.add_colour(colour(2))) == [(0, None)]


@pytest.mark.parametrize("behind", [1, 2])
def test_depth_that_comes_a_period_or_two_later_is_waited_for(behind: int) -> None:
    """It is aligned by a node of its own; all of it was left out."""
    pairs, found = DepthPairs(TOLERANCE), list[EncodedView]()
    for i in range(3 * IN_VAIN):
        if i >= behind:
            found += pairs.add_depth(depth(i - behind))
        found += pairs.add_colour(colour(i))
    assert told(found) == [(i * PERIOD, i * PERIOD) for i in range(3 * IN_VAIN - behind)]


def test_depth_that_comes_too_late_holds_nothing_up() -> None:
    pairs = DepthPairs(TOLERANCE)
    for i in range(3 * IN_VAIN):
        pairs.add_depth(depth(i - 4))
        last = pairs.add_colour(colour(i))
    assert told(last) == [((3 * IN_VAIN - 1) * PERIOD, None)]


def test_a_clock_that_is_put_back_ends_no_pairing() -> None:
    pairs, found = DepthPairs(TOLERANCE), list[EncodedView]()
    for i in [*range(200, 220), *range(20)]:
        found = pairs.add_colour(colour(i)) + pairs.add_depth(depth(i))
    assert told(found) == [(19 * PERIOD, 19 * PERIOD)]


def test_an_image_of_before_a_clock_was_put_back_holds_none_up() -> None:
    pairs = DepthPairs(TOLERANCE)
    assert pairs.add_colour(colour(1)) == []
    assert told(pairs.add_colour(colour(0))) == [(PERIOD, None)]


def test_a_depth_that_has_failed_is_waited_for_no_longer_until_it_is_back() -> None:
    """Held back, each of the camera's images, and all others with it, would be a period older."""
    pairs = DepthPairs(TOLERANCE)
    last = IN_VAIN + 1
    for i in range(last):
        assert len(pairs.add_colour(colour(i))) == (i > 1)
    assert told(pairs.add_colour(colour(last)))[-1] == (last * PERIOD, None)
    assert told(pairs.add_colour(colour(last + 1))) == [((last + 1) * PERIOD, None)]
    assert pairs.add_depth(depth(last + 1)) == []
    assert pairs.add_colour(colour(last + 2)) == []
    assert told(pairs.add_depth(depth(last + 2))) == [((last + 2) * PERIOD, (last + 2) * PERIOD)]
