"""The compiled verdicts on voxels against the plain ones."""

from __future__ import annotations

import numpy as np
import pytest
from forecast_worlds import RIG
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast.kernels import kernels
from twin_node.forecast.tables import Blocks, CameraTable
from twin_node.forecast.verdicts import (
    FREE,
    LIKELY_MOVES,
    MAY_MOVE,
    UNKNOWN,
    Sight,
    Surface,
    carved,
    carved_plainly,
    verdicts,
    verdicts_plainly,
)
from twin_node.scene import Grid

BLOCKS = Blocks(Grid(np.array([-0.5, -0.4, 0.1]), 0.05, (21, 18, 14)))
TABLES = tuple(CameraTable(camera, BLOCKS) for camera in RIG)


def random_sight(table: CameraTable, rng: np.random.Generator) -> Sight:
    """Depths about those of the grid, any flags; outside the image nothing is freed or explained."""
    free_until, end = np.where(rng.uniform(size=(2, table.outside + 1)) < 0.8, 0, rng.uniform(1, 3)).astype(np.float32)
    flags = rng.integers(0, 16, table.outside + 1).astype(np.uint8)
    free_until[-1] = end[-1] = flags[-1] = 0
    begin = end - rng.uniform(0, 1, len(end)).astype(np.float32)
    return Sight(table, free_until, flags, Surface(begin, end) if rng.uniform() < 0.5 else None)


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(0, 4))
def test_compiled_verdicts_are_the_plain_ones(seed: int, views: int) -> None:
    rng = np.random.default_rng(seed)
    sights = [random_sight(table, rng) for table in TABLES[:views]]
    chosen = np.flatnonzero(rng.uniform(size=BLOCKS.count) < 0.7)
    assert np.array_equal(verdicts(BLOCKS, chosen, sights), verdicts_plainly(BLOCKS, chosen, sights))


def test_every_verdict_occurs_and_other_blocks_are_free() -> None:
    rng = np.random.default_rng(1)
    chosen = np.arange(0, BLOCKS.count, 2)
    found = verdicts(BLOCKS, chosen, [random_sight(table, rng) for table in TABLES])
    assert set(np.unique(found)) == {FREE, UNKNOWN, MAY_MOVE, LIKELY_MOVES}
    others = BLOCKS.indices(BLOCKS.places(np.arange(1, BLOCKS.count, 2)))
    assert not found[others].any()


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@given(st.integers(0, 2**32 - 1), st.integers(0, 70))
def test_compiled_lists_are_the_plain_ones(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    given_verdicts = np.where(rng.uniform(size=size) < 0.7, FREE, rng.integers(0, 4, size)).astype(np.uint8)
    one, other = carved(given_verdicts), carved_plainly(given_verdicts)
    assert np.array_equal(one.moving, other.moving)
    assert np.array_equal(one.likely, other.likely)
    assert np.array_equal(one.unknown, other.unknown)
