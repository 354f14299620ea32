"""Velocities of parts from the images: small things that fly far between two of them, newcomers, views at odds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID, RIG, ball_voxels, camera, state_of

from twin_node.forecast.agreement import Estimate
from twin_node.forecast.experts import GRAVITY
from twin_node.forecast.image_motion import Window
from twin_node.forecast.measured import UNKNOWN_SPEED
from twin_node.forecast.part_velocities import PartVelocities, spread_about
from twin_node.forecast.parts import Parts, split
from twin_node.forecast.tables import RigTables
from twin_node.scene import Float64, TwinState

PERIOD_S = 1 / 30


def parts_of_ball(center: Float64, radius: float) -> Parts:
    voxels = ball_voxels(center, radius)
    return split(GRID, voxels, np.ones(len(voxels), np.bool_))


def unknown(parts: Parts) -> Estimate:
    return Estimate.unknown(parts.count)


def nothing() -> Parts:
    """What is known of space in the set before, where only the images are to tell how things moved."""
    return split(GRID, np.zeros(0, np.int64), np.zeros(0, np.bool_))


@pytest.mark.parametrize("speed", [0.5, 3.0, 6.0])
def test_a_ball_is_as_fast_as_it_flies(speed: float) -> None:
    """At 6 m/s it flies 20 cm, nearly its width, between two images."""
    direction = np.array([0.6, 0.64, -0.48])
    velocities = PartVelocities(RigTables(GRID))
    mean, sigma = np.zeros(3), UNKNOWN_SPEED
    for number in range(5):
        center = np.array([-0.2, -0.2, 0.55]) + number * PERIOD_S * speed * direction
        state = state_of(round(number * PERIOD_S * 1e9), center, radius=0.11, cameras=RIG)
        parts = parts_of_ball(center, 0.11)
        expected = Estimate(np.tile(mean, (parts.count, 1)), np.full(parts.count, sigma))
        moving, _ = velocities.update(state, parts, expected)
        mean, sigma = moving.velocities.mean(axis=0), float(moving.sigmas.mean())
    assert np.linalg.norm(mean - speed * direction) < 0.35 * speed


def test_two_images_with_depth_tell_how_fast_a_newcomer_comes_at_the_camera() -> None:
    """Flow alone shows next to nothing of it: the ball only grows."""
    lone = camera("lone", np.array([2.0, 0.0, 0.5]))
    velocity = np.array([2.0, 0.0, 0.05])
    followed = {}
    for with_depth in (False, True):
        velocities = PartVelocities(RigTables(GRID))
        for number in range(2):
            center = np.array([-0.1, 0.0, 0.5]) + number * PERIOD_S * velocity
            state = state_of(round(number * PERIOD_S * 1e9), center, cameras=(lone,), with_depth=with_depth)
            parts = parts_of_ball(center, 0.12) if number else nothing()
            followed[with_depth], _ = velocities.update(state, parts, unknown(parts))
    assert abs(np.median(followed[True].velocities[:, 0]) - 2.0) < 0.5
    assert followed[True].sigmas.min() < 0.6 * followed[False].sigmas.min()


def test_a_view_at_odds_with_three_others_loses_its_say() -> None:
    velocity = np.array([0.4, 0.9, 0.0])

    def seen(number: int) -> TwinState:
        stamp, start = round(number * PERIOD_S * 1e9), np.array([0.0, -0.1, 0.5])
        true, false = (state_of(stamp, start + sign * number * PERIOD_S * velocity) for sign in (1, -2))
        views = (false.frames.views[0], *true.frames.views[1:])
        masks = (false.moving_masks[0], *true.moving_masks[1:])
        return replace(true, frames=replace(true.frames, views=views), moving_masks=masks)

    velocities = PartVelocities(RigTables(GRID))
    for number in range(2):
        parts = parts_of_ball(np.array([0.0, -0.1, 0.5]) + PERIOD_S * velocity, 0.12) if number else nothing()
        moving, _ = velocities.update(seen(number), parts, unknown(parts))
    assert np.linalg.norm(np.median(moving.velocities, axis=0) - velocity) < 0.25


def test_what_the_image_before_does_not_show_tells_nothing() -> None:
    """A ball that was not there has no velocity; its standard deviation says so."""
    velocities = PartVelocities(RigTables(GRID))
    center = np.array([0.0, 0.0, 0.5])
    velocities.update(state_of(0, None), parts_of_ball(center, 0.0), unknown(parts_of_ball(center, 0.0)))
    parts = parts_of_ball(center, 0.12)
    moving, _ = velocities.update(state_of(round(PERIOD_S * 1e9), center), parts, unknown(parts))
    np.testing.assert_array_equal(moving.velocities, 0)
    np.testing.assert_allclose(moving.sigmas, UNKNOWN_SPEED)


def test_a_thing_as_grey_as_what_stands_is_painted_is_followed() -> None:
    """What moves is told by the mask; no brightness stands for rest."""
    velocity = np.array([2.0, 4.0, 1.0])
    velocities = PartVelocities(RigTables(GRID))
    for number in range(2):
        stamp, center = round(number * PERIOD_S * 1e9), np.array([-0.1, -0.2, 0.5]) + number * PERIOD_S * velocity
        state = state_of(stamp, center, radius=0.09)
        views = tuple(replace(view, rgb=np.full_like(view.rgb, 128)) for view in state.frames.views)
        parts = parts_of_ball(center, 0.09) if number else nothing()
        moving, _ = velocities.update(replace(state, frames=replace(state.frames, views=views)), parts, unknown(parts))
    assert np.linalg.norm(np.median(moving.velocities, axis=0) - velocity) < 0.3 * np.linalg.norm(velocity)


def test_what_falls_goes_as_all_of_it_went_whatever_its_surface_does() -> None:
    """A ball that spins: its surface goes another way than it does."""
    velocities, start, speed = PartVelocities(RigTables(GRID)), np.array([-0.4, -0.2, 0.5]), np.array([2.0, 0.5, 1.0])
    for number in range(6):
        seconds = number * PERIOD_S
        center = start + seconds * speed + seconds**2 / 2 * GRAVITY
        state, parts = state_of(round(seconds * 1e9), center, with_depth=True), parts_of_ball(center, 0.12)
        turned = (replace(view, rgb=np.roll(view.rgb, 3 * number, axis=1)) for view in state.frames.views)
        state = replace(state, frames=replace(state.frames, views=tuple(turned)))
        moving, whole = velocities.update(state, parts, unknown(parts))
    assert whole.falling.all()
    assert np.allclose(moving.velocities, speed + seconds * GRAVITY, atol=0.35)
    assert (moving.sigmas < 0.2).all()


@pytest.mark.parametrize("window", [Window(20, 60, 10, 45), Window(0, 33, 0, 32), Window(70, 100, 31, 80)])
def test_shifts_spread_over_a_window_are_those_of_the_whole_image(window: Window) -> None:
    rng = np.random.default_rng(1)
    width, height = 100, 80
    columns, rows = rng.integers(window.left, window.right, 60), rng.integers(window.top, window.bottom, 60)
    pixels, shifts = rows * width + columns, rng.normal(0, 5, (60, 2))
    whole = spread_about(Window(0, width, 0, height), pixels, shifts, (width, height))
    spread = spread_about(window, pixels, shifts, (width, height))
    assert np.array_equal(spread, whole[window.slices])
    assert np.ptp(spread[..., 0]) > 5


@pytest.mark.parametrize(("gap_s", "is_told"), [(0.1, True), (0.4, True), (0.6, False)])
def test_images_from_before_a_long_gap_tell_no_velocity(gap_s: float, is_told: bool) -> None:
    """What has gone to and fro meanwhile looks as if it stood."""
    velocities = PartVelocities(RigTables(GRID))
    center = np.array([0.0, 0.0, 0.45])
    parts = parts_of_ball(center, 0.11)
    velocities.update(state_of(0, center, radius=0.11, cameras=RIG), nothing(), unknown(nothing()))
    later = state_of(round(gap_s * 1e9), center, radius=0.11, cameras=RIG)
    moving, _ = velocities.update(later, parts, unknown(parts))
    assert (moving.sigmas < 1.0).all() == is_told
    assert (moving.sigmas == UNKNOWN_SPEED).all() != is_told


@pytest.mark.parametrize(("width", "height", "is_told"), [(16, 6, 0), (100, 7, 0), (11, 11, 0), (64, 8, 1)])
def test_images_too_small_for_optical_flow_tell_no_velocity(width: int, height: int, is_told: int) -> None:
    """As those of a wide strip at the least width are; OpenCV refuses them."""
    scale = width / RIG[0].width
    K = np.array([[90 * scale, 0, width / 2], [0, 90 * scale, height / 2], [0, 0, 1]])
    shallow = tuple(replace(one, width=width, height=height, K=K) for one in RIG)
    velocities, center = PartVelocities(RigTables(GRID)), np.array([0.0, 0.0, 0.45])
    parts = parts_of_ball(center, 0.2)
    for number in range(2):
        state = state_of(round(number * PERIOD_S * 1e9), center, radius=0.2, cameras=shallow)
        moving, _ = velocities.update(state, parts, unknown(parts))
    assert (moving.sigmas < UNKNOWN_SPEED).any() == is_told
