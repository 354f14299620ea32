"""The compiled moving mask against the one in NumPy, on scenes that reach all of its branches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.model.camera_mask import CameraMask
from twin_node.model.compiled_mask import can_compile, update_compiled
from twin_node.scene import Bool, Camera, View

pytestmark = pytest.mark.skipif(not can_compile(), reason="no compiled kernels here")
HEIGHT, WIDTH, SETS = 45, 70, 40
CAMERA = Camera("cam", WIDTH, HEIGHT, np.eye(3), np.eye(4))
ROUNDING = 2
"""Pixels per image that may fall on the other side of a threshold: sums are taken in another order."""


def scene(seed: int, with_depth: bool) -> list[View]:
    """A patch that is there from the start slides off, another comes, rings, stops and goes; the light drifts."""
    rng = np.random.default_rng(seed)
    floor = np.repeat(np.repeat(rng.uniform(60, 170, (5, 7, 3)), 9, 0), 10, 1)
    floor[20:32, 8:22] = rng.uniform(0, 255, 3)
    colour, views = rng.uniform(0, 255, 3), []
    under = floor.copy()
    under[20:32, 8:22] = np.repeat(np.repeat(rng.uniform(90, 130, (2, 2, 3)), 6, 0), 7, 1)
    for index in range(SETS):
        image, depth = (floor if index < 4 else under).copy(), np.full((HEIGHT, WIDTH), 1.5, np.float32)
        left = min(2 * index, 40)
        if index >= 4:
            image[20:32, 8 + left : 22 + left] = floor[20:32, 8:22]
        if 5 < index < 32:
            image[2:18, left : left + 16], depth[2:18, left : left + 16] = colour, 1.2
            image[6:14, left + 4 : left + 12] = under[6:14, left + 4 : left + 12]
        image = image * (1 + 0.003 * index) + rng.normal(0, 1.5, image.shape)
        depth += rng.normal(0, 0.004 * (seed % 5), depth.shape) * depth**2
        depth[rng.random(depth.shape) < 0.05] = 0
        rgb = np.clip(image, 0, 255).astype(np.uint8)
        views.append(View(CAMERA, index * 33_000_000, rgb, depth if with_depth else None))
    return views


def arm(index: int, sees_arm: bool) -> Bool | None:
    """A bar that waits and sweeps aside: some pixels are met late, beside a thing that has come there meanwhile."""
    if not sees_arm:
        return None
    mask, swept = np.zeros((HEIGHT, WIDTH), bool), 2 * max(index - 18, 0)
    mask[:, 50 + swept : 64 + swept] = True
    return mask


def follow(compiled: CameraMask, plain: CameraMask) -> None:
    """What both remember of pixels is the same but for rounding, and from now on wholly: one pixel must not spread."""
    for name in ("mask", "known", "trusted", "confirmed"):
        found, expected = getattr(compiled, name), getattr(plain, name)
        assert np.count_nonzero(found != expected) <= ROUNDING, name
        setattr(compiled, name, expected.copy())


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10**6), st.booleans(), st.booleans())
def test_the_compiled_mask_is_that_in_numpy_and_leaves_the_same_behind(seed: int, depth: bool, sees_arm: bool) -> None:
    views = scene(seed, depth)
    plain, compiled = (CameraMask(views[0]) for _ in range(2))
    marked = 0
    for index, view in enumerate(views):
        robot = arm(index, sees_arm)
        expected, (found,) = plain.update(view, robot), update_compiled([compiled], [view], [robot])
        marked += int(expected.sum())
        assert np.count_nonzero(found != expected) <= ROUNDING
        follow(compiled, plain)
    assert marked > 100
    assert compiled.sigma == pytest.approx(plain.sigma, rel=1e-3)
    assert compiled.bared == pytest.approx(plain.bared, abs=ROUNDING)
    assert (plain.bared == 0) == depth
    assert np.mean(np.abs(compiled.background - plain.background) > 0.01) < 1e-3
    assert np.count_nonzero(compiled.still_ns != plain.still_ns) <= ROUNDING
    assert np.abs(compiled.colours.ground - plain.colours.ground).sum() < 1e-3 * plain.colours.ground.sum()
    assert compiled.depth.noise == pytest.approx(plain.depth.noise, rel=1e-3)
    if depth:
        for name in ("known", "measured", "telling", "blind_ns"):
            differs = np.abs(getattr(compiled.depth, name) - getattr(plain.depth, name)) > 1e-5
            assert np.count_nonzero(differs) <= ROUNDING


@pytest.mark.parametrize(("levels", "noise_m"), [(1.0, 0.002), (8.0, 0.02), (60.0, 0.5)])
def test_noise_is_told_as_in_numpy_be_it_usual_loud_or_louder_than_noise_is(levels: float, noise_m: float) -> None:
    rng = np.random.default_rng(7)
    rgbs = np.clip(120 + rng.normal(0, levels, (6, HEIGHT, WIDTH, 3)), 0, 255).astype(np.uint8)
    depths = np.abs(1.5 + noise_m * 1.5**2 * rng.normal(size=(6, HEIGHT, WIDTH))).astype(np.float32)
    views = [View(CAMERA, tick * 33_000_000, *of) for tick, of in enumerate(zip(rgbs, depths, strict=True))]
    plain, compiled = (CameraMask(views[0]) for _ in range(2))
    for view in views:
        plain.update(view, None)
        update_compiled([compiled], [view], [None])
        follow(compiled, plain)
        assert compiled.sigma == pytest.approx(plain.sigma, rel=1e-5)
        assert compiled.depth.noise == pytest.approx(plain.depth.noise, rel=1e-5)
        assert np.count_nonzero(compiled.still_ns != plain.still_ns) <= ROUNDING, "loud noise is still all the same"
    assert plain.sigma > 0 and plain.depth.noise > 0


def test_wide_gaps_are_closed_as_in_numpy() -> None:
    views = [replace(view, rgb=np.repeat(np.repeat(view.rgb, 6, 0), 6, 1)) for view in scene(2, False)[:14]]
    plain, compiled = (CameraMask(views[0]) for _ in range(2))
    assert compiled.closing.shape[0] > 12
    for view in views:
        expected, (found,) = plain.update(view, None), update_compiled([compiled], [view], [None])
        assert np.count_nonzero(found != expected) <= 36 * ROUNDING
        compiled.mask = plain.mask.copy()
    assert expected.any() and not expected.all()


@pytest.mark.parametrize(
    "cut", [(slice(25, 26), slice(None)), (slice(None), slice(14, 15)), (slice(24, 26), slice(None))]
)
def test_lines_of_one_and_two_pixels_are_images_too(cut: tuple[slice, slice]) -> None:
    """What lies beyond a side is mirrored: of a line of one pixel that is the pixel itself."""
    views = [replace(view, rgb=np.ascontiguousarray(view.rgb[cut])) for view in scene(1, False)]
    plain, compiled = (CameraMask(views[0]) for _ in range(2))
    uncovered = 0
    for view in views:
        expected, (found,) = plain.update(view, None), update_compiled([compiled], [view], [None])
        uncovered += np.count_nonzero(plain.confirmed)
        assert np.count_nonzero(found != expected) <= ROUNDING
        follow(compiled, plain)
    assert uncovered


def test_several_cameras_at_once_are_those_one_by_one() -> None:
    scenes = [scene(seed, False) for seed in (3, 4, 5)]
    together, alone = ([CameraMask(views[0]) for views in scenes] for _ in range(2))
    for views in zip(*scenes, strict=True):
        at_once = update_compiled(together, views, [None] * 3)
        one_by_one = [update_compiled([c], [v], [None])[0] for c, v in zip(alone, views, strict=True)]
        assert all(np.array_equal(a, b) for a, b in zip(at_once, one_by_one, strict=True))


def test_images_too_large_for_the_kernels_are_left_to_numpy() -> None:
    small, large = (np.zeros((height, 40, 3), np.uint8) for height in (90, 1200))
    camera = Camera("cam", 2000, 1200, np.eye(3), np.eye(4))
    wide = np.zeros((1200, 1300, 3), np.uint8)
    assert can_compile([CameraMask(View(camera, 0, rgb)) for rgb in (small, large)])
    assert not can_compile([CameraMask(View(camera, 0, rgb)) for rgb in (small, wide)])
