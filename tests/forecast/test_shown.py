"""What images show of parts that move: compiled, the same as by NumPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import RIG
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast.image_motion import Image, Shifts, traced, traced_plainly
from twin_node.forecast.kernels import kernels
from twin_node.forecast.shown import Told, Visible, told, told_plainly, visible, visible_plainly
from twin_node.forecast.tables import Blocks, CameraTable
from twin_node.scene import Float32, Grid

pytestmark = pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
BLOCKS = Blocks(Grid(np.array([-0.5, -0.4, 0.1]), 0.05, (21, 18, 14)))
HEIGHT, WIDTH = 13, 17
TABLE = CameraTable(replace(RIG[0], height=HEIGHT, width=WIDTH), BLOCKS)


def random_depth(rng: np.random.Generator) -> Float32:
    return np.where(rng.uniform(size=(HEIGHT, WIDTH)) < 0.3, 0, rng.uniform(1, 3, (HEIGHT, WIDTH))).astype(np.float32)


def random_image(rng: np.random.Generator) -> Image:
    grey = rng.integers(0, 80, (HEIGHT, WIDTH)).astype(np.uint8)
    depth = random_depth(rng) if rng.uniform() < 0.7 else None
    return Image(0, grey, rng.uniform(size=(HEIGHT, WIDTH)) < 0.6, depth)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_compiled_traces_are_the_plain_ones(seed: int) -> None:
    rng = np.random.default_rng(seed)
    now, before = random_image(rng), random_image(rng)
    shifts = np.round(4 * rng.normal(size=(HEIGHT, WIDTH, 2))).astype(np.float32) / 2  # halves are rounded to even
    found, plain = traced(now, before, shifts), traced_plainly(now, before, shifts)
    assert np.array_equal(found.found, plain.found) and found.found.any()
    assert (found.receded is None) == (plain.receded is None)
    if found.receded is not None and plain.receded is not None:
        assert np.array_equal(found.receded, plain.receded, equal_nan=True)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 400))
def test_compiled_visible_voxels_are_the_plain_ones(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    places = BLOCKS.locate(np.sort(rng.integers(0, BLOCKS.grid.size, count)))
    labels = rng.integers(0, 9, 2 * count)[::2]
    moving = rng.uniform(size=(HEIGHT, WIDTH)) < 0.7
    found, plain = visible(moving, TABLE, places, labels), visible_plainly(moving, TABLE, places, labels)
    assert np.array_equal(found.pixels, plain.pixels) and np.array_equal(found.labels, plain.labels)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 200))
def test_what_compiled_pixels_tell_is_what_plain_ones_do(seed: int, count: int) -> None:
    rng, parts = np.random.default_rng(seed), 12
    flying, found = rng.uniform(size=(2, HEIGHT, WIDTH)) < 0.5
    receded = np.where(found, rng.normal(0, 0.2, found.shape), np.nan).astype(np.float32)
    depth = random_depth(rng)
    moved = rng.normal(0, 3, (HEIGHT, WIDTH, 2)).astype(np.float32)
    measured = (receded, depth) if rng.uniform() < 0.7 else (None, None)
    shifts = Shifts(moved, found, *measured, flying, 0.033)
    seen = Visible(rng.integers(0, found.size, count), rng.integers(0, parts, count))
    one, other = told(shifts, seen, parts), told_plainly(shifts, seen, parts)
    for name in Told.__dataclass_fields__:
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
