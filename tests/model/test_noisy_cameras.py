"""Cameras that are noisier than usual: noise is no thing that moves, and what truly comes still is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from twin_node.bench.masks import ModelMasks
from twin_node.cell import CellSource, load_scenario
from twin_node.model import WindowModel
from twin_node.model.ground_depth import GroundDepth, with_noise
from twin_node.model.moving_mask import MovingMask
from twin_node.scene import Bool, Camera, Float32, FrameSet, View
from twin_node.scene.depth_noise import MOST_NOISE, NOISE_SIGMAS, noise_slack

HEIGHT, WIDTH = 60, 80
STEP_NS = 50_000_000
CAMERA = Camera("cam", WIDTH, HEIGHT, np.eye(3), np.eye(4))
SLOPE = np.linspace(0.8, 3.0, HEIGHT, dtype=np.float32)[:, None].repeat(WIDTH, 1)
"""[H, W] m, a floor that recedes."""
SPOT = (slice(20, 40), slice(30, 50))


def images(noise_m: float, spot: Float32 | None = None, count: int = 40, seed: int = 1) -> Iterator[View]:
    """Views of even grey; from the middle one on something else is at the spot, of the same colour."""
    rng = np.random.default_rng(seed)
    for tick in range(count):
        depth = SLOPE.copy()
        if spot is not None and tick >= count // 2:
            depth[SPOT] = spot
        depth += (noise_m * depth**2 * rng.normal(size=depth.shape)).astype(np.float32)
        rgb = np.clip(120 + rng.normal(0, 1.5, (HEIGHT, WIDTH, 3)), 0, 255).astype(np.uint8)
        yield View(CAMERA, tick * STEP_NS, rgb, depth)


def masks(noise_m: float, spot: Float32 | None = None) -> list[Bool]:
    mask = MovingMask()
    return [mask.update(FrameSet(view.stamp, (view,)), [None])[0] for view in images(noise_m, spot)]


@pytest.mark.parametrize("noise_m", [0.0, 0.002, 0.004, 0.006, 0.01, 0.02])
def test_noise_does_not_move(noise_m: float) -> None:
    assert sum(int(mask.sum()) for mask in masks(noise_m)) == 0


@pytest.mark.parametrize("noise_m", [0.002, 0.006, 0.01])
def test_what_comes_before_the_ground_does_though_colours_do_not_tell(noise_m: float) -> None:
    """By twice as much as noise may be."""
    nearer = SLOPE[SPOT] - 2 * np.maximum(noise_slack(SLOPE[SPOT], noise_m), 0.05)
    found = masks(noise_m, nearer)
    assert not any(mask.any() for mask in found[:20])
    assert found[-1][SPOT].mean() > 0.95


@pytest.mark.parametrize("levels", [2.0, 8.0, 15.0, 30.0])
@pytest.mark.parametrize("with_depth", [False, True])
def test_noise_of_colours_does_not_move_either(levels: float, with_depth: bool) -> None:
    """From the second image on: what has been held for moving is not measured any more."""
    rng, mask = np.random.default_rng(2), MovingMask()
    coarse = np.repeat(np.repeat(rng.uniform(60, 190, (6, 8, 3)), 10, 0), 10, 1)
    thing = np.array([250.0, 20.0, 20.0])
    for view in images(0.002, count=21):
        shown = coarse.copy()
        if view.stamp >= 20 * STEP_NS:
            shown[SPOT] = thing
        rgb = np.clip(shown + rng.normal(0, levels, shown.shape), 0, 255).astype(np.uint8)
        seen = replace(view, rgb=rgb, depth=view.depth if with_depth else None)
        (held,) = mask.update(FrameSet(view.stamp, (seen,)), [None])
        if view.stamp < 20 * STEP_NS:
            assert held.sum() <= 2
    if levels < 20:
        assert held[SPOT].mean() > 0.9


@pytest.mark.parametrize("levels", [10.0, 15.0])
@pytest.mark.parametrize("with_depth", [False, True])
def test_noise_that_rises_at_once_moves_for_a_moment_only(levels: float, with_depth: bool) -> None:
    """The light goes out and the gain goes up: for good nothing was still enough to be known for ground again."""
    rng, mask = np.random.default_rng(2), MovingMask()
    thing, shares = np.array([250.0, 20.0, 20.0]), list[float]()
    for tick, view in enumerate(images(0.002, count=81)):
        shown = np.full((HEIGHT, WIDTH, 3), 120.0)
        shown[SPOT] = thing if tick == 80 else 120.0
        rgb = np.clip(shown + rng.normal(0, levels if tick >= 20 else 1.5, shown.shape), 0, 255).astype(np.uint8)
        seen = replace(view, rgb=rgb, depth=view.depth if with_depth else None)
        (held,) = mask.update(FrameSet(view.stamp, (seen,)), [None])
        shares.append(float(held.mean()))
    assert max(shares[:20]) == 0
    assert shares[20] > 0.01, "it could be something that has come"
    assert max(shares[60:80]) < 1e-3
    assert held[SPOT].mean() > 0.9


@pytest.mark.parametrize("noise_m", [0.001, 0.004, 0.012])
def test_noise_is_measured_where_nothing_moves(noise_m: float) -> None:
    """Of an image half of which something else has come to."""
    first, *views = images(noise_m)
    ground, moving = GroundDepth(first), np.zeros((HEIGHT, WIDTH), np.bool_)
    moving[:, WIDTH // 2 :] = True
    for view in (first, *views):
        assert view.depth is not None
        depth = np.where(moving, view.depth + 0.1 * (view.stamp // STEP_NS % 2), view.depth)
        seen = replace(view, depth=depth.astype(np.float32))
        ground.measure_noise(seen, ~moving)
        ground.learn(seen, np.full_like(depth, 0.05), ~moving)
    assert ground.noise == pytest.approx(noise_m, rel=0.1)


def test_too_few_pixels_tell_no_noise() -> None:
    views = list(images(0.01))
    ground, few = GroundDepth(views[0]), np.zeros((HEIGHT, WIDTH), np.bool_)
    few[:8] = True
    for view in views:
        ground.measure_noise(view, few)
        ground.learn(view, np.full_like(SLOPE, 0.05), few)
    assert ground.noise == 0


@pytest.mark.parametrize(
    ("known", "noise", "usual", "expected"),
    [
        (0.0, 2.0, 1.0, 1.05),  # as usual: drawn from there
        (0.0, 4.0, 1.0, 4.0),  # loud: whole
        (0.0, 40.0, 1.0, 10.0),  # more than noise can be
        (0.0, 0.5, 0.0, 0.5),  # nothing is usual
        (0.0, 0.0, 0.0, 0.0),
        (4.0, 24.0, 1.0, 5.0),  # known: drawn, however loud
    ],
)
def test_only_the_first_loud_noise_counts_whole(known: float, noise: float, usual: float, expected: float) -> None:
    assert with_noise(known, noise, usual, most=10.0) == pytest.approx(expected)


def test_noise_counts_for_a_share_of_a_depth_at_most() -> None:
    """What has not been seen yet is infinitely far for some, and a thing still stands before it."""
    depths = np.array([0.5, 2.0, 1e6], np.float32)
    slack = noise_slack(depths, 0.01)
    assert slack[:2] == pytest.approx(NOISE_SIGMAS * 0.01 * depths[:2] ** 2)
    assert slack[2] == pytest.approx(MOST_NOISE * depths[2])
    assert not noise_slack(depths, 0.0).any()


@pytest.mark.parametrize(("sigma_mm", "shared_px"), [(4.0, 0.0), (8.0, 0.0), (2.0, 1.5), (6.0, 1.5)])
def test_nothing_moves_where_an_arm_works_alone_before_noisy_cameras(sigma_mm: float, shared_px: float) -> None:
    """The arm's rims, and what it puts down and takes up, included."""
    pick = load_scenario("pick").at_width(160)
    assert pick.arm is not None
    arm = replace(pick.arm, cycle=replace(pick.arm.cycle, speed=3.0, acceleration=8.0, dwell_s=0.3))
    sensing = replace(pick.sensing, rate_hz=15.0, depth_sigma_at_1m_mm=sigma_mm, depth_noise_px=shared_px)
    source = CellSource(replace(pick, arm=arm, cameras=pick.cameras[:2], duration_s=4.0, sensing=sensing))
    assert source.simulated.world.arm is not None
    mask = ModelMasks(source.simulated.world.arm.model)
    held = [sum(int(one.sum()) for one, _ in mask.update(frames)) for frames in source]
    assert max(held) < 10


def test_a_state_tells_how_noisy_its_cameras_are() -> None:
    demo = load_scenario("demo").at_width(80)
    source = CellSource(replace(demo, duration_s=0.5, sensing=replace(demo.sensing, depth_sigma_at_1m_mm=5.0)))
    model = WindowModel()
    states = [model.look(frames) for frames in source]
    names = [view.camera.name for view in states[-1].frames.views]
    for name in names:
        assert states[0].depth_noise_of(name) == 0
        assert states[-1].depth_noise_of(name) == pytest.approx(0.005, rel=0.2)
    assert states[-1].depth_noise_of("another") == 0
    assert replace(states[-1], depth_noise=()).depth_noise_of(names[0]) == 0


def warned_of_full_masks(levels: float, covered: float, seconds: float, mends: bool = False) -> list[bool]:
    """Whether each set warned that a camera's mask stays full: from 1 s on its noise is other, or somebody before it.

    Where it `mends` that ends after 12 s.
    """
    mask, rng, told = MovingMask(), np.random.default_rng(1), []
    for tick in range(round(seconds * 1e9 / STEP_NS)):
        is_other = 20 <= tick < (240 if mends else 10_000)
        rgb = 120 + rng.normal(0, levels if is_other else 1.5, (HEIGHT, WIDTH, 3))
        if is_other and covered:
            rgb[:, : round(covered * WIDTH)] = rng.uniform(0, 255, (HEIGHT, round(covered * WIDTH), 3))
        view = View(CAMERA, tick * STEP_NS, np.clip(rgb, 0, 255).astype(np.uint8))
        mask.update(FrameSet(view.stamp, (view,)), [None])
        told.append(any("camera cam: nearly all that it sees has moved for 10 s" in one for one in mask.warnings))
    return told


def test_a_mask_that_stays_full_is_told_of_by_its_camera() -> None:
    """Who dimmed the light, and so raised the gain, had an arm that stood for what moves, and nobody in the cell."""
    told = warned_of_full_masks(40.0, 0.0, 13.0)
    assert told.index(True) == 220
    assert all(told[220:])
    assert not any(warned_of_full_masks(1.5, 0.7, 13.0)), "who stands before the camera leaves some of it to be seen"


def test_a_full_mask_that_is_mended_is_no_longer_told_of() -> None:
    told = warned_of_full_masks(1.5, 1.0, 20.0, mends=True)
    assert told[230] and not told[-1]
