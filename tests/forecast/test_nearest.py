"""The nearest of points: found by looking at all as by a tree."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.forecast.nearest import nearest, nearest_one, nearest_reference


@pytest.mark.parametrize("within", [np.inf, 0.3])
@pytest.mark.parametrize("count", [1, 8])
@pytest.mark.parametrize(("points", "others"), [(0, 5), (3, 0), (1, 1), (40, 7), (120, 333), (300, 700)])
def test_compiled_as_reference(points: int, others: int, count: int, within: float) -> None:
    rng = np.random.default_rng(points)
    asked, among = rng.random((points, 3)), rng.random((4, others, 3))
    found, expected = (one(asked, among, count, within) for one in (nearest, nearest_reference))
    assert found.distances.shape == found.rows.shape == (4, points, count)
    assert np.array_equal(found.distances, expected.distances)
    assert np.array_equal(found.rows, expected.rows)
    alone = nearest(asked, among[2], count, within)
    assert np.array_equal(alone.rows, found.rows[2])


def test_what_is_nowhere_is_near_to_nothing() -> None:
    places = np.array([[0.0, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0]])
    found = nearest(places, places, 2)
    assert found.rows[:, 0].tolist() == [0, 3, 3]
    assert found.rows[0, 1] == 3
    assert np.isinf(found.distances[1:]).all()


@pytest.mark.parametrize("others", [0, 1, 90])
def test_one_of_several_as_near_is_the_one_that_a_tree_finds(others: int) -> None:
    lattice = np.stack(np.meshgrid(*[np.arange(5.0)] * 3), axis=-1).reshape(-1, 3)
    asked, among = lattice + np.array([0.5, 0.0, 0.0]), lattice[:others]
    found, expected = nearest_one(asked, among, 1.2), nearest_reference(asked, among, 1, 1.2)
    assert np.array_equal(found.rows, expected.rows[:, 0])
    assert np.array_equal(found.distances, expected.distances[:, 0])


@pytest.mark.parametrize("has_ties", [False, True])
@pytest.mark.parametrize("side", [7, 8, 9])
def test_among_many_who_is_taken_is_who_a_tree_finds(side: int, has_ties: bool) -> None:
    """Of more than are looked at by themselves, and than are looked at when one is wanted."""
    lattice = np.stack(np.meshgrid(*[np.arange(float(side))] * 3), axis=-1).reshape(-1, 3)
    asked = lattice + (np.array([0.5, 0.0, 0.0]) if has_ties else np.random.default_rng(1).uniform(0, 1, lattice.shape))
    found, expected = nearest(asked, lattice, 1, 0.9), nearest_reference(asked, lattice, 1, 0.9)
    assert np.array_equal(found.rows, expected.rows)
    assert np.array_equal(found.distances, expected.distances)
