"""What images show of parts that move: compiled, the same as by NumPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import RIG
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast.image_motion import Pair, seen, seen_reference
from twin_node.forecast.kernels import kernels
from twin_node.forecast.shown import Sample, Visible, Witness, told, told_reference, visible, visible_reference
from twin_node.forecast.tables import Blocks, CameraTable
from twin_node.scene import Bool, Float32, Grid, View

pytestmark = pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
BLOCKS = Blocks(Grid(np.array([-0.5, -0.4, 0.1]), 0.05, (21, 18, 14)))
HEIGHT, WIDTH = 13, 17
TABLE = CameraTable(replace(RIG[0], height=HEIGHT, width=WIDTH), BLOCKS)


def random_depth(rng: np.random.Generator) -> Float32:
    return np.where(rng.uniform(size=(HEIGHT, WIDTH)) < 0.3, 0, rng.uniform(1, 3, (HEIGHT, WIDTH))).astype(np.float32)


def random_view(rng: np.random.Generator, stamp: int) -> View:
    depth = random_depth(rng) if rng.uniform() < 0.8 else None
    return View(TABLE.camera, stamp, rng.integers(0, 80, (HEIGHT, WIDTH, 3)).astype(np.uint8), depth)


def random_mask(rng: np.random.Generator) -> Bool:
    """Some squares, whole and with holes: blobs of all sizes, at the image's sides too."""
    mask = rng.uniform(size=(HEIGHT, WIDTH)) < rng.choice([0, 0.02, 0.3])
    for _ in range(int(rng.integers(4))):
        row, column, side = rng.integers(HEIGHT), rng.integers(WIDTH), rng.integers(1, 9)
        mask[row : row + side, column : column + side] = True
    return np.asarray(mask)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_compiled_images_are_the_plain_ones(seed: int) -> None:
    rng = np.random.default_rng(seed)
    view, mask = random_view(rng, 0), random_mask(rng)
    (one,), other = seen([view], [mask]), seen_reference(view, mask)
    for name in ("stamp", "window"):
        assert getattr(one, name) == getattr(other, name)
    for name in ("grey", "moving"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    assert np.array_equal(one.blobs.labels > 0, other.blobs.labels > 0)
    assert len(one.blobs.compact) == len(other.blobs.compact)
    mine = {tuple(blob) for blob in one.blobs.compact[:, 1:].tolist()}
    assert mine == {tuple(blob) for blob in other.blobs.compact[:, 1:].tolist()}
    for row, (label, area) in enumerate(one.blobs.compact[:, :2].tolist()):
        assert one.blobs.pixels_of(row).sum() == area and label > 0


def random_pair(rng: np.random.Generator) -> Pair:
    """Of blobs that flow, and of some that fly."""
    views = [random_view(rng, stamp) for stamp in (33_000_000, 0)]
    now, before = seen(views, [random_mask(rng) for _ in views])
    window = now.window.joined(before.window).within(WIDTH, HEIGHT)
    flow = np.round(4 * rng.normal(size=(HEIGHT, WIDTH, 2))).astype(np.float32) / 2  # halves are rounded to even
    return Pair(now, before, window, np.ascontiguousarray(flow[window.slices]))


def random_sample(rng: np.random.Generator, count: int, parts: int) -> Sample:
    places = BLOCKS.locate(np.sort(rng.integers(0, BLOCKS.grid.size, count)))
    centers = BLOCKS.grid.centers(rng.integers(0, BLOCKS.grid.size, parts))
    return Sample(places, rng.integers(0, parts, 2 * count)[::2], centers)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 400))
def test_compiled_visible_voxels_are_the_plain_ones(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    moving, sample = rng.uniform(size=(HEIGHT, WIDTH)) < 0.7, random_sample(rng, count, 9)
    beside = rng.uniform(size=(HEIGHT, WIDTH)) < 0.2
    for mask, found in zip((moving, beside), visible([moving, beside], [TABLE] * 2, sample), strict=True):
        same_as_reference(found, visible_reference(mask, TABLE, sample))


def same_as_reference(found: Visible, plain: Visible) -> None:
    assert np.array_equal(found.pixels, plain.pixels) and np.array_equal(found.labels, plain.labels)
    np.testing.assert_allclose(found.jacobian, plain.jacobian, rtol=1e-9, atol=1e-9)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_what_compiled_pixels_tell_is_what_plain_ones_do(seed: int) -> None:
    rng, parts = np.random.default_rng(seed), 12
    pair = random_pair(rng)
    shown = np.flatnonzero(pair.now.moving)
    pixels = rng.choice(shown, 3 * len(shown)) if len(shown) else shown
    pixels = pixels if rng.uniform() < 0.8 else rng.integers(0, WIDTH * HEIGHT, 50)
    seen_pixels = Visible(pixels, rng.integers(0, parts, len(pixels)), rng.normal(0, 80, (parts, 2, 3)))
    witness = Witness(pair, seen_pixels, np.array([0.0, 0.6, 0.8]))
    (one, again), other = told([witness, witness]), told_reference(witness)
    assert np.array_equal(one.shifts, again.shifts)
    for name in ("elapsed_s", "shifts", "shown", "receded", "depths", "axis"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    np.testing.assert_allclose(one.variances, other.variances, rtol=1e-12)


def test_a_blob_that_flies_takes_all_of_its_pixels_along() -> None:
    """Ten pixels to the right and 0.5 m away from the camera, which flow does not know."""
    images = []
    for stamp, (column, depth) in enumerate([(1, 2.0), (11, 2.5)]):
        mask = np.zeros((HEIGHT, WIDTH), np.bool_)
        mask[4:8, column : column + 4] = True
        depths = np.where(mask, depth, 3.0).astype(np.float32)
        view = View(TABLE.camera, stamp * 33_000_000, np.full((HEIGHT, WIDTH, 3), 90, np.uint8), depths)
        images += seen([view], [mask])
    before, now = images
    window = now.window.joined(before.window).within(WIDTH, HEIGHT)
    pair = Pair(now, before, window, np.zeros((window.bottom - window.top, window.right - window.left, 2), np.float32))
    pixels = np.flatnonzero(now.moving)
    seen_pixels = Visible(pixels, np.zeros(len(pixels), np.int64), np.ones((1, 2, 3)))
    witness = Witness(pair, seen_pixels, np.array([0.0, 0.0, 1.0]))
    for found in (*told([witness]), told_reference(witness)):
        np.testing.assert_allclose(found.shifts, [[10, 0]], atol=1e-6)
        assert found.shown.all() and np.isfinite(found.variances).all()
        assert found.receded[0] == 0  # what goes 15 m/s is another surface
