"""What cameras without depth do not see past: what stands, and what another one measures to move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID, HEIGHT, RIG, WIDTH, camera, pixels_of, state_of
from numpy.typing import NDArray

from twin_node.forecast import Forecaster
from twin_node.forecast.carving import Carver, Opaque
from twin_node.forecast.tables import RigTables
from twin_node.geometry import project
from twin_node.scene import Camera, Float64, FrameSet, TwinState

CENTER = np.array([0.1, -0.05, 0.45])


def beyond(cam: Camera, center: Float64) -> NDArray[np.int64]:
    """Flat index [1] of the voxel 0.3 m behind a place, as a camera sees it."""
    away = center - cam.T_base_cam[:3, 3]
    return GRID.indices((center + 0.3 * away / np.linalg.norm(away))[None])


def block_at(center: Float64) -> NDArray[np.int64]:
    """Flat indices [n] of a block of voxels."""
    return np.flatnonzero(np.abs(GRID.centers(np.arange(GRID.size)) - center).max(axis=1) < 0.1)


def test_a_camera_without_depth_frees_its_rays_up_to_what_is_known_to_stand() -> None:
    wall = np.flatnonzero(np.abs(GRID.centers(np.arange(GRID.size)) - [0.0, 0.0, 0.45]).max(axis=1) < 0.1)
    carver, state = Carver(RigTables(GRID)), state_of(0, None, cameras=RIG[:1])
    away = RIG[0].T_base_cam[:3, 3] - [0.0, 0.0, 0.45]
    step = 0.3 * away / np.linalg.norm(away)
    before, behind = (GRID.indices(np.array([[0.0, 0.0, 0.45]]) + way) for way in (step, -step))
    assert not carver.carve(state, 0.0).unknown.holds(np.concatenate([before, behind])).any()
    unknown = carver.carve(state, 0.0, Opaque(wall)).unknown
    assert not unknown.holds(before).any() and unknown.holds(behind).all()
    assert carver.carve(state, 0.0).unknown.holds(behind).all(), "as for the state before"
    assert not carver.carve(state, 0.0, Opaque(wall[:0])).unknown.holds(behind).any()
    assert not carver.carve(state, 0.0, Opaque(wall, 0.5)).unknown.holds(behind).any(), "it may lie behind that"


@pytest.mark.parametrize("turned", [0.0, 0.7])
@pytest.mark.parametrize("away", [0.4, 0.9, 1.9])
def test_a_camera_without_depth_sees_through_no_wall_however_near_it_stands(away: float, turned: float) -> None:
    """Voxels that are nearer than the middle of the grid are larger in the image."""
    eye = np.array([0.2 + away, 0.0, 0.45])
    near = replace(camera("near", eye, roll=turned), width=3 * WIDTH, height=3 * HEIGHT)
    near = replace(near, K=np.diag([3.0, 3.0, 1.0]) @ near.K)
    centers = GRID.centers(np.arange(GRID.size))
    wall = np.flatnonzero(np.abs(centers[:, 0] - 0.2) < 0.6 * GRID.voxel_size)
    unknown = Carver(RigTables(GRID)).carve(state_of(0, None, cameras=(near,)), 0.0, Opaque(wall)).unknown.mask()
    u, v, z = project(near.K, near.viewmat, centers).T
    rim = near.K[0, 0] * GRID.voxel_size / away  # where half of a voxel may be beside the image
    is_seen = (z > 0) & (u > rim) & (u < near.width - rim) & (v > rim) & (v < near.height - rim)
    crossing = eye + (centers - eye) * ((away / (eye[0] - centers[:, 0]).clip(1e-3))[:, None])
    is_behind = (centers[:, 0] < 0.15) & (np.abs(crossing[:, 1]) < 0.55) & (np.abs(crossing[:, 2] - 0.45) < 0.4)
    assert np.count_nonzero(is_seen & is_behind) > 500
    assert unknown[is_seen & is_behind].all()
    before = is_seen & (centers[:, 0] > 0.3) & (np.abs(centers[:, 0] - eye[0]) > 0.1)
    assert not unknown[before].any()


def test_a_camera_without_depth_does_not_see_past_what_another_measures_to_move() -> None:
    """It has taken somebody who keeps still for ground."""
    measured, flat = (state_of(0, CENTER, cameras=(one,), with_depth=one is RIG[0]) for one in RIG[:2])
    frames = FrameSet(0, (*measured.frames.views, *flat.frames.views))
    nothing = np.zeros((HEIGHT, WIDTH), np.bool_)
    state = replace(measured, frames=frames, moving_masks=(*measured.moving_masks, nothing), robot_masks=(None, None))
    alone, both = (
        Carver(RigTables(GRID)).carve(measured, 0.0).may_move.indices(),
        Carver(RigTables(GRID)).carve(state, 0.0).may_move.indices(),
    )
    front = alone[np.linalg.norm(GRID.centers(alone) - RIG[0].T_base_cam[:3, 3], axis=1) < 2.01]
    assert len(front) > 20
    assert np.isin(front, both).mean() > 0.9


def test_a_camera_whose_depth_image_is_lost_does_not_see_past_what_stands_before_the_grid() -> None:
    """A screen between the camera and the workspace: no voxel stands there."""
    state = state_of(0, None, cameras=RIG[:1], with_depth=True)
    (view,) = state.frames.views
    assert view.depth is not None
    screen = np.where(np.arange(WIDTH) < WIDTH // 2, np.float32(0.5), view.depth)
    carver = Carver(RigTables(GRID))
    carver.carve(replace(state, frames=replace(state.frames, views=(replace(view, depth=screen),))), 0.0)
    unknown = carver.carve(state_of(33_000_000, None, cameras=RIG[:1]), 0.0).unknown.mask()
    centers = GRID.centers(np.arange(GRID.size))
    pixel = pixels_of(view.camera, centers)
    assert unknown[(pixel >= 0) & (pixel % WIDTH < WIDTH // 2)].all()
    assert not unknown[(pixel >= 0) & (pixel % WIDTH >= WIDTH // 2) & (centers[:, 2] > 0.1)].any()


def before_cabinet(state: TwinState) -> TwinState:
    """The state before something dark, of which cameras measure no depth."""
    is_dark = np.zeros((HEIGHT, WIDTH), np.bool_)
    is_dark[20:50, 30:66] = True
    views = (
        view if view.depth is None else replace(view, depth=np.where(is_dark, np.float32(0), view.depth))
        for view in state.frames.views
    )
    return replace(state, frames=replace(state.frames, views=tuple(views)))


def test_a_camera_whose_depth_image_is_lost_sees_past_nothing_that_it_has_never_measured() -> None:
    """A dark cabinet: with its depth image a camera frees nothing there, and without it freed all that is behind."""
    carver, state = Carver(RigTables(GRID)), state_of(0, None, cameras=RIG[:2], with_depth=True)
    before = carver.carve(before_cabinet(state), 0.0).unknown
    lost = carver.carve(state_of(33_000_000, None, cameras=RIG[:2]), 0.0).unknown
    hidden = before.indices()[GRID.centers(before.indices())[:, 2] > 0.06]  # the floor has no voxels that stand here
    assert len(hidden) > 5000 and lost.holds(hidden).all()
    assert lost.count < 1.2 * before.count, "elsewhere it frees as much"


def test_what_may_be_behind_a_dark_cabinet_is_not_forgotten_for_a_depth_image_that_is_lost() -> None:
    forecaster, hidden = Forecaster(GRID), []
    for number in range(3):
        state = state_of(number * 33_000_000, None, cameras=RIG[:2], with_depth=number != 1)
        hidden.append(forecaster.update(before_cabinet(state), state.stamp).hidden)
    assert hidden[0].maybe_full.count > 5000
    assert hidden[2].maybe_full.count == hidden[0].maybe_full.count


def test_a_camera_without_depth_sees_past_neither_what_stands_nor_what_is_measured_to_move() -> None:
    ball, stands, bare = (np.array([x, 0.1, 0.45]) for x in (0.3, -0.3, 0.0))
    measured, flat = state_of(0, ball, 0.1, RIG[:1], with_depth=True), state_of(0, None, cameras=RIG[1:2])
    (view,), (mask,) = measured.frames.views, measured.moving_masks
    assert view.depth is not None
    only_ball = replace(view, depth=np.where(mask, view.depth, 0).astype(np.float32))
    frames, masks = FrameSet(0, (only_ball, *flat.frames.views)), (mask, *flat.moving_masks)
    state = replace(measured, frames=frames, moving_masks=masks, robot_masks=(None, None))
    carved = Carver(RigTables(GRID)).carve(state, 0.0, Opaque(block_at(stands)))
    held = np.concatenate([carved.may_move.indices(), carved.unknown.indices()])
    assert np.isin([beyond(RIG[1], ball), beyond(RIG[1], stands)], held).all()
    assert not np.isin(beyond(RIG[1], bare), held).any()


def test_what_stands_hides_other_space_from_a_camera_that_was_moved() -> None:
    carver, stands = Carver(RigTables(GRID)), np.array([0.1, -0.25, 0.45])
    opaque = Opaque(block_at(stands))
    for cam in (RIG[0], replace(RIG[1], name=RIG[0].name)):
        unknown = carver.carve(state_of(0, None, cameras=(cam,)), 0.0, opaque).unknown
        assert unknown.holds(beyond(cam, stands)).all()
