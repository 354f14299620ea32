"""What views say along their rays: compiled, the same as by NumPy and OpenCV."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import RIG
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast.backdrops import UNMEASURED, UNSEEN, revised, revised_reference
from twin_node.forecast.kernels import kernels
from twin_node.forecast.sights import CarvingParameters, Look, sight_reference, sights_of
from twin_node.forecast.tables import Blocks, CameraTable
from twin_node.forecast.verdicts import MOVING
from twin_node.scene import Bool, Float32, Grid, View

pytestmark = pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
BLOCKS = Blocks(Grid(np.array([-0.5, -0.4, 0.1]), 0.1, (8, 6, 5)))


def patches(rng: np.random.Generator, height: int, width: int, share: float) -> Bool:
    """A mask of boxes, and single pixels on and off."""
    mask = rng.uniform(size=(height, width)) < share / 20
    for _ in range(4):
        rows, columns = (sorted(rng.integers(0, size + 1, 2)) for size in (height, width))
        mask[slice(*rows), slice(*columns)] |= rng.uniform() < share
    return mask ^ (rng.uniform(size=mask.shape) < 0.01)


def depths(rng: np.random.Generator, height: int, width: int) -> Float32:
    """Of steps and noise; some are not measured."""
    steps = np.where(patches(rng, height, width, 0.5), 0.6, 2.0) + rng.normal(0, 0.01, (height, width))
    return np.where(patches(rng, height, width, 0.2), 0, steps).astype(np.float32)


def random_look(rng: np.random.Generator, error_pixels: float) -> Look:
    """Any masks, with depth or without."""
    height, width = (int(n) for n in rng.integers(1, 60, 2))
    camera = replace(RIG[0], width=width, height=height)
    masks = [patches(rng, height, width, share) for share in (0.5, 0.3, 0.8)]
    robot, valid = (mask if rng.uniform() < 0.7 else None for mask in masks[1:])
    depth = depths(rng, height, width) if rng.uniform() < 0.8 else None
    backdrop = None if depth is None else (depth + rng.choice([0, 0.02, 0.1, 0.5, 1e6], depth.shape)).astype(np.float32)
    view = View(camera, 0, np.zeros((height, width, 3), np.uint8), depth, valid)
    return Look(CameraTable(camera, BLOCKS), view, masks[0], robot, backdrop, error_pixels)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 3), st.sampled_from((0.7, 1.0, 1.5, 3.2)))
def test_compiled_sights_are_the_plain_ones(seed: int, views: int, error_pixels: float) -> None:
    rng, parameters = np.random.default_rng(seed), CarvingParameters()
    looks = [random_look(rng, error_pixels) for _ in range(views)]
    for look, found in zip(looks, sights_of(looks, parameters), strict=True):
        plain = sight_reference(look, parameters)
        assert np.array_equal(found.flags, plain.flags)
        assert np.array_equal(found.free_until, plain.free_until)
        assert (found.surface is None) == (plain.surface is None)
        if found.surface is not None and plain.surface is not None:
            assert np.array_equal(found.surface.begin, plain.surface.begin)
            assert np.array_equal(found.surface.end, plain.surface.end)


def test_a_view_that_is_hidden_throughout_is_as_wide_as_can_be() -> None:
    look = random_look(np.random.default_rng(3), 1.5)
    depth = np.full(look.moving.shape, 1.5, np.float32)
    look = replace(look, view=replace(look.view, depth=depth, valid=None), moving=depth > 0, backdrop=2 * depth)
    (found,), plain = sights_of([look], CarvingParameters()), sight_reference(look, CarvingParameters())
    assert found.surface is not None and plain.surface is not None
    assert np.array_equal(found.surface.end, plain.surface.end)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_compiled_backdrops_are_the_plain_ones(seed: int) -> None:
    rng = np.random.default_rng(seed)
    height, width = (int(n) for n in rng.integers(1, 40, 2))
    kept = np.where(patches(rng, height, width, 0.4), rng.choice([UNSEEN, UNMEASURED]), depths(rng, height, width))
    kept = kept.astype(np.float32)
    moving, robot = patches(rng, height, width, 0.5), patches(rng, height, width, 0.3)
    noise = float(rng.choice([0.0, 0.002, 0.02]))
    given_ = (kept, depths(rng, height, width), moving, robot if rng.uniform() < 0.5 else None, noise)
    one, other = revised(*given_), revised_reference(*given_)
    assert np.array_equal(one.kept, other.kept)
    assert np.array_equal(one.filled, other.filled)


@pytest.mark.parametrize("is_measured", [False, True])
def test_what_is_measured_beside_a_thin_thing_that_is_not_frees_nothing_there(is_measured: bool) -> None:
    """A dark forearm far away, two pixels wide; where it is measured, a pixel without depth frees what is before it."""
    camera = replace(RIG[0], width=30, height=20)
    arm, behind = np.zeros((20, 30), bool), np.full((20, 30), 2, np.float32)
    arm[5:15, 12:14] = True
    depth = np.where(arm, np.float32(1.5 if is_measured else 0), behind)
    depth[8, 12] = 0
    view = View(camera, 0, np.zeros((20, 30, 3), np.uint8), depth)
    look = Look(CameraTable(camera, BLOCKS), view, arm, None, behind, 0.7)
    for sight in (*sights_of([look], CarvingParameters()), sight_reference(look, CarvingParameters())):
        free = sight.free_until[:-1].reshape(20, 30)
        assert free[arm] == pytest.approx(1.47 if is_measured else 0)
        assert (free[~arm] > 1.9).all()
        assert bool(sight.flags[8 * 30 + 12] & MOVING)


def test_an_edge_that_is_measured_here_and_there_is_no_thin_thing() -> None:
    """Somebody has passed before a table's edge, half of whose pixels lack depth: what they left was held for 0.2 s."""
    camera = replace(RIG[0], width=30, height=20)
    passed, behind = np.zeros((20, 30), bool), np.full((20, 30), 2, np.float32)
    passed[2:18, 8:20] = True
    lacking = np.zeros((20, 30), bool)
    lacking[2:18:2, 13], lacking[3:18:2, 14] = True, True
    view = View(camera, 0, np.zeros((20, 30, 3), np.uint8), np.where(lacking, np.float32(0), behind))
    look = Look(CameraTable(camera, BLOCKS), view, passed, None, behind, 0.7)
    for sight in (*sights_of([look], CarvingParameters()), sight_reference(look, CarvingParameters())):
        assert (sight.free_until[:-1] > 1.9).all()
