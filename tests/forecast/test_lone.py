"""What one camera alone sees move, and does not measure, is a warning, wherever other cameras look."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID, HEIGHT, RIG, WIDTH, ball_voxels, state_of

from twin_node.forecast import Forecaster, ForecastResult
from twin_node.forecast.grid import decode_runs
from twin_node.forecast.lone import FRESH_NS
from twin_node.scene import FrameSet, TwinState

STEP_NS = 33_000_000


def state(tick: int, y: float, blind: tuple[int, ...], measuring: tuple[int, ...] = ()) -> TwinState:
    """A ball at `y` m, which the `blind` ones of three cameras do not show: nothing at all of where it is."""
    seen = [
        state_of(tick * STEP_NS, np.array([0.0, y, 0.45]), 0.15, (one,), n in measuring)
        for n, one in enumerate(RIG[:3])
    ]
    views = [one.frames.views[0] for one in seen]
    masks = [one.moving_masks[0] for one in seen]
    for number in blind:
        views[number] = replace(views[number], valid=np.zeros((HEIGHT, WIDTH), np.bool_))
        masks[number] = np.zeros((HEIGHT, WIDTH), np.bool_)
    frames = FrameSet(tick * STEP_NS, tuple(views))
    return replace(seen[0], frames=frames, moving_masks=tuple(masks), robot_masks=(None,) * 3)


def dark(tick: int, y: float, cameras: int) -> TwinState:
    """The same before so many depth cameras, of which the first alone shows the ball, and measures nothing of it."""
    one = state(tick, y, (1, 2), (0, 1, 2))
    first, *others = one.frames.views
    assert first.depth is not None
    depth = np.where(one.moving_masks[0], 0, first.depth).astype(np.float32)
    frames = replace(one.frames, views=(replace(first, depth=depth), *others)[:cameras])
    masks, robots = one.moving_masks[:cameras], one.robot_masks[:cameras]
    return replace(one, frames=frames, moving_masks=masks, robot_masks=robots)


def told(states: list[TwinState]) -> list[bool]:
    forecaster, found = Forecaster(GRID), []
    for one in states:
        forecaster.update(one, one.stamp + STEP_NS)
        found.append(any("alone shows" in line for line in forecaster.quality.warnings))
    return found


@pytest.mark.parametrize("measuring", [(), (2,)])
def test_who_comes_in_before_one_camera_alone_is_a_warning_until_another_sees_them(measuring: tuple[int, ...]) -> None:
    alone = [state(tick, 0.05 * tick - 0.3, (1, 2), measuring) for tick in range(10)]
    found = told([*alone, *(state(tick, 0.05 * tick - 0.3, (), measuring) for tick in range(10, 14))])
    assert all(found[4:10])
    assert not any(found[11:])


def test_what_keeps_still_is_none_nor_what_a_camera_measures() -> None:
    still = 4 + FRESH_NS // STEP_NS
    assert not any(told([state(tick, 0.1, (1, 2)) for tick in range(2 * still)])[still:])
    assert not any(told([state(tick, 0.05 * tick - 0.3, (1, 2), (0,)) for tick in range(10)]))


def test_what_keeps_still_and_was_measured_is_none_without_its_depth_image_either() -> None:
    """It shows nothing new, though before it was no part of what is not measured."""
    still = [state(tick, 0.1, (1, 2), (0,)) for tick in range(20)]
    assert not any(told([*still, state(20, 0.1, (1, 2)), *(state(tick, 0.1, (1, 2), (0,)) for tick in (21, 22))]))


@pytest.mark.parametrize("cameras", [1, 3])
def test_who_comes_in_before_one_depth_camera_that_measures_nothing_of_them_is_a_warning(cameras: int) -> None:
    assert all(told([dark(tick, 0.05 * tick - 0.3, cameras) for tick in range(10)])[4:])


@pytest.mark.parametrize("measuring", [True, False])
def test_who_keeps_still_before_one_camera_and_is_not_measured_may_come_out_of_all_that_is_unknown_there(
    measuring: bool,
) -> None:
    forecaster = Forecaster(GRID)
    for tick in range(30):
        now = dark(tick, 0.05 * min(tick, 6) - 0.3, 1)
        if tick == 0:
            now = replace(now, moving_masks=(np.zeros((HEIGHT, WIDTH), np.bool_),))  # seen to be empty
        if not measuring:
            views = tuple(replace(view, depth=None) for view in now.frames.views)
            now = replace(now, frames=replace(now.frames, views=views))
        found = forecaster.update(now, now.stamp + STEP_NS)

    unknown = np.intersect1d(ball_voxels(np.array([0.0, 0.0, 0.45]), 0.13), _unknown(found))
    assert len(unknown) > 100
    assert found.hidden.reachable.holds(unknown).mean() > 0.95


def _unknown(found: ForecastResult) -> np.ndarray:
    """Flat indices of a forecast's unknown voxels."""
    return np.flatnonzero(decode_runs(found.occupancy.unknown_runs, GRID.size))
