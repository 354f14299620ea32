"""The compiled verdicts on voxels against the plain ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import RIG
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast.bits import Bits
from twin_node.forecast.kernels import kernels
from twin_node.forecast.tables import Blocks, CameraTable
from twin_node.forecast.verdicts import (
    FREE,
    LIKELY_MOVES,
    MAY_MOVE,
    ON_ARM,
    UNKNOWN,
    Carved,
    Sight,
    Surface,
    carved,
    carved_reference,
    verdicts_reference,
)
from twin_node.scene import Grid

BLOCKS = Blocks(Grid(np.array([-0.5, -0.4, 0.1]), 0.05, (21, 18, 14)))
TABLES = tuple(CameraTable(camera, BLOCKS) for camera in RIG)


DIMS = BLOCKS.grid.dims


def assert_the_same(one: Carved, other: Carved) -> None:
    for name in ("may_move", "likely_moves", "unknown", "on_arm"):
        assert np.array_equal(getattr(one, name).words, getattr(other, name).words), name


def random_sight(table: CameraTable, rng: np.random.Generator, patch: int = 1) -> Sight:
    """Depths about those of the grid and any flags, the same over patches so many pixels wide.

    Outside the image nothing is freed or explained.
    """
    height, width = table.camera.height, table.camera.width
    rows, columns = np.arange(height) // patch, np.arange(width) // patch
    patches = np.append((rows[:, None] * width + columns).ravel(), table.outside)
    free_until, end = np.where(rng.uniform(size=(2, table.outside + 1)) < 0.8, 0, rng.uniform(1, 3)).astype(np.float32)
    flags = np.where(rng.uniform(size=table.outside + 1) < 0.5, 0, rng.integers(0, 16, table.outside + 1))
    free_until, end, flags = free_until[patches], end[patches], flags.astype(np.uint8)[patches]
    free_until[-1] = end[-1] = flags[-1] = 0
    begin = end - rng.uniform(0, 1, len(end)).astype(np.float32)
    return Sight(table, free_until, flags, Surface(begin, end) if rng.uniform() < 0.5 else None)


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.sampled_from((1, 7, 40)))
def test_compiled_verdicts_are_the_plain_ones(seed: int, views: int, patch: int) -> None:
    rng = np.random.default_rng(seed)
    sights = [random_sight(table, rng, patch) for table in TABLES[:views]]
    assert_the_same(carved(BLOCKS, sights), carved_reference(BLOCKS, sights))


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@pytest.mark.parametrize("does", ["keeps", "frees", "shows"])
def test_single_pixels_are_not_passed_over_for_those_about_them(does: str) -> None:
    """About one in each block's part of the image: whole blocks are decided by the least and the most there."""
    for seed, table in enumerate(TABLES * 3):
        rng = np.random.default_rng(seed)
        rare = rng.uniform(size=table.outside + 1) < 1 / 150
        rare[-1] = False
        depth = rng.uniform(1, 3, len(rare)).astype(np.float32)
        free_until = {"keeps": np.where(rare, 0, 5), "frees": np.where(rare, depth, 0)}.get(does, 0 * depth)
        free_until[-1] = 0
        begin, end = (
            np.where(rare, here, beside).astype(np.float32) for here, beside in ((depth - 0.3, 9), (depth, 0))
        )
        flags = np.zeros(len(rare), np.uint8)
        sight = Sight(table, free_until.astype(np.float32), flags, Surface(begin, end) if does == "shows" else None)
        assert_the_same(carved(BLOCKS, [sight]), carved_reference(BLOCKS, [sight]))


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
def test_blocks_larger_in_the_image_than_any_window_are_decided_voxel_by_voxel() -> None:
    wide = replace(RIG[0], width=1600, height=1200, K=np.array([[1600.0, 0, 800], [0, 1600.0, 600], [0, 0, 1]]))
    table = CameraTable(wide, BLOCKS)
    assert (table.of_blocks.small.windows[:, 1] - table.of_blocks.small.windows[:, 0]).max() > 128
    sight = random_sight(table, np.random.default_rng(2), 150)
    assert_the_same(carved(BLOCKS, [sight]), carved_reference(BLOCKS, [sight]))


def test_every_verdict_occurs() -> None:
    rng = np.random.default_rng(1)
    found = verdicts_reference(BLOCKS, [random_sight(table, rng) for table in TABLES])
    assert set(np.unique(found)) == {FREE, ON_ARM, UNKNOWN, MAY_MOVE, LIKELY_MOVES}


def test_what_is_taken_is_free() -> None:
    rng = np.random.default_rng(1)
    found = carved(BLOCKS, [random_sight(table, rng) for table in TABLES])
    taken = Bits.of_mask(DIMS, rng.uniform(size=BLOCKS.grid.size) < 0.5)
    left = found.without(taken)
    for name in ("may_move", "likely_moves", "unknown"):
        before, after = getattr(found, name).mask(), getattr(left, name).mask()
        assert before.any() and np.array_equal(after, before & ~taken.mask())
