"""Forecasts of large images are made of fewer pixels, where voxels are coarse enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID, RIG, ball_voxels, state_of

from twin_node.forecast import BaselineForecaster, Forecaster, ForecastError
from twin_node.forecast.narrowed import LEAST_WIDTH, NarrowedStates
from twin_node.scene import Camera, TwinState

TIMES = 8
"""How many times as many pixels each way the wide rig has."""


def wide(camera: Camera) -> Camera:
    scale = np.diag([TIMES, TIMES, 1.0])
    return replace(camera, width=TIMES * camera.width, height=TIMES * camera.height, K=scale @ camera.K)


WIDE = tuple(wide(camera) for camera in RIG)


def place(stamp: int) -> np.ndarray:
    return np.array([-0.2 + 0.5e-9 * stamp, 0.0, 0.3])


def states(sets: int = 15) -> list[TwinState]:
    """A ball that slides past the wide rig, which measures its depth."""
    return [state_of(k * 33_000_000, place(k * 33_000_000), cameras=WIDE, with_depth=True) for k in range(sets)]


def test_what_is_seen_to_move_or_of_the_robot_is_so_in_fewer_pixels() -> None:
    state = state_of(0, np.array([0.0, 0.0, 0.3]), cameras=WIDE[:1], with_depth=True)
    (moving,) = state.moving_masks
    speck, robot = np.zeros_like(moving), np.zeros_like(moving)
    speck[101, 203] = True
    robot[100:140, 200:240] = True
    narrow = NarrowedStates(GRID).of(replace(state, moving_masks=(moving | speck,), robot_masks=(robot,)))
    (view,), (found,), (of_robot,) = narrow.frames.views, narrow.moving_masks, narrow.robot_masks
    assert of_robot is not None
    assert LEAST_WIDTH <= view.camera.width < WIDE[0].width
    assert view.misfit(moving=found, robot=of_robot) is None
    factor = WIDE[0].width // view.camera.width
    assert found[101 // factor, 203 // factor], "a single pixel that moves is not lost"
    assert found.mean() == pytest.approx(moving.mean(), rel=0.1)
    assert of_robot.sum() == (40 / factor) ** 2 - 1
    assert not (found & of_robot).any(), "who touches the robot is not left out with it"


def test_small_images_and_those_that_fine_voxels_need_stay_as_they_are() -> None:
    small, state = state_of(0, place(0)), states(1)[0]
    fine = replace(GRID, voxel_size=GRID.voxel_size / 8, dims=tuple(8 * side for side in GRID.dims))
    assert NarrowedStates(GRID).of(small) is small
    assert NarrowedStates(fine).of(state) is state
    beside = replace(GRID, origin=WIDE[0].T_base_cam[:3, 3] - 2 * WIDE[0].T_base_cam[:3, 2])
    assert NarrowedStates(beside).of(state).frames.views[0] is state.frames.views[0], "the grid is behind this camera"


def test_the_forecast_is_that_of_the_fewer_pixels() -> None:
    narrowed, of_all, of_fewer = NarrowedStates(GRID), Forecaster(GRID), Forecaster(GRID)
    for state in states():
        found = of_all.update(state, state.stamp).occupancy
        expected = of_fewer.update(narrowed.of(state), state.stamp).occupancy
    for one, other in zip(found.layers, expected.layers, strict=True):
        assert np.array_equal(one.indices, other.indices)
        ahead = ball_voxels(place(found.stamp + one.horizon_ns))
        assert np.isin(ahead, one.indices).mean() > 0.95


def test_baselines_stand_on_the_evidence_of_the_fewer_pixels_too() -> None:
    """Else they are compared with forecasts of other masks and other surfaces."""
    narrowed, of_all, of_fewer = NarrowedStates(GRID), BaselineForecaster(GRID), BaselineForecaster(GRID)
    for state in states(4):
        of_all.update(state, state.stamp)
        of_fewer.update(narrowed.of(state), state.stamp)
        np.testing.assert_array_equal(of_all.places, of_fewer.places)


def test_masks_of_another_size_are_refused_as_those_of_small_images_are() -> None:
    state = states(1)[0]
    halved = tuple(mask[::2, ::2] for mask in state.moving_masks)
    with pytest.raises(ForecastError, match=f"camera {WIDE[0].name}: expected moving"):
        Forecaster(GRID).update(replace(state, moving_masks=halved), state.stamp)
