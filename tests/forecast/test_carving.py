"""The carving rules, on exact silhouettes of a ball."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from forecast_worlds import GRID, HEIGHT, RIG, WIDTH, WORKSPACE, ball_voxels, camera, pixels_of, state_of

from twin_node.forecast.carving import Carved, Carver
from twin_node.forecast.tables import RigTables
from twin_node.scene import Camera, TwinState

CENTER = np.array([0.1, -0.05, 0.45])


def carve(state: TwinState, speed: float = 0.0) -> Carved:
    return Carver(RigTables(GRID)).carve(state, speed)


def test_hull_holds_the_ball_and_not_much_more() -> None:
    carved = carve(state_of(0, CENTER))
    ball = ball_voxels(CENTER)
    assert np.isin(ball, carved.moving).all()
    assert len(carved.moving) < 8 * len(ball)


def test_blocks_agree_with_voxels_one_by_one() -> None:
    state = state_of(0, CENTER)
    carved = carve(state)
    centers = GRID.centers(np.arange(GRID.size))
    freed = np.zeros(GRID.size, np.bool_)
    for view, mask in zip(state.frames.views, state.moving_masks, strict=True):
        pixel = pixels_of(view.camera, centers)
        freed |= (pixel >= 0) & ~mask.ravel()[pixel]
    assert freed[carved.unknown].sum() == 0
    assert np.isin(np.flatnonzero(~freed), np.concatenate([carved.moving, carved.unknown])).all()


def test_nothing_moving_frees_all_that_is_seen() -> None:
    carved = carve(state_of(0, None))
    assert len(carved.moving) == 0
    unseen = np.ones(GRID.size, np.bool_)
    for cam in RIG:
        unseen &= pixels_of(cam, GRID.centers(np.arange(GRID.size))) < 0
    assert np.array_equal(carved.unknown, np.flatnonzero(unseen))


def test_one_camera_alone_explains_nothing_without_depth() -> None:
    alone = carve(state_of(0, CENTER, cameras=RIG[:1]))
    assert len(alone.moving) == 0
    assert np.isin(ball_voxels(CENTER), alone.unknown).all()


def test_depth_cuts_the_hull_at_the_surface() -> None:
    pair = RIG[:2]
    colour, depth = (carve(state_of(0, CENTER, cameras=pair, with_depth=known)) for known in (False, True))
    assert np.isin(ball_voxels(CENTER, 0.1), depth.moving).all()
    assert len(depth.moving) < 0.95 * len(colour.moving)


def test_depth_frees_nothing_behind_the_measured_surface() -> None:
    high = np.array([0.0, 0.0, 0.5])
    carved = carve(state_of(0, high, radius=0.2, cameras=RIG[:1], with_depth=True))
    away = RIG[0].T_base_cam[:3, 3] - high
    behind = GRID.indices((high - 0.35 * away / np.linalg.norm(away))[None])
    before = GRID.indices((high + 0.35 * away / np.linalg.norm(away))[None])
    assert np.isin(behind, np.concatenate([carved.moving, carved.unknown])).all()
    assert not np.isin(before, np.concatenate([carved.moving, carved.unknown])).any()


def test_unknown_depth_frees_nothing() -> None:
    state = state_of(0, None, cameras=RIG[:1], with_depth=True)
    view = replace(state.frames.views[0], depth=np.zeros((HEIGHT, WIDTH), np.float32))
    carved = carve(replace(state, frames=replace(state.frames, views=(view,))))
    assert len(carved.unknown) == GRID.size


def test_shadow_of_the_robot_is_unknown_and_the_robot_left_out() -> None:
    arm = np.zeros((HEIGHT, WIDTH), np.bool_)
    arm[:, WIDTH // 2 - 6 : WIDTH // 2 + 6] = True
    middle = GRID.indices(WORKSPACE.mean(axis=0)[None])
    one = carve(state_of(0, None, cameras=RIG[:1], robot_masks=(arm,)))
    assert np.isin(middle, one.unknown).all()
    all_around = carve(state_of(0, None, robot_masks=(arm,) * len(RIG)))
    assert not np.isin(middle, all_around.unknown).any()
    assert len(all_around.moving) == 0


def test_what_the_robot_hides_in_one_view_is_still_found_by_the_others() -> None:
    everything = np.ones((HEIGHT, WIDTH), np.bool_)
    state = state_of(0, CENTER, robot_masks=(everything, None, None, None))
    masks = (np.zeros((HEIGHT, WIDTH), np.bool_), *state.moving_masks[1:])
    assert np.isin(ball_voxels(CENTER), carve(replace(state, moving_masks=masks)).moving).all()


def test_calibration_error_and_skew_widen_the_hull() -> None:
    rough: tuple[Camera, ...] = tuple(replace(cam, sigma_m=0.03) for cam in RIG)
    plain, widened = carve(state_of(0, CENTER)), carve(state_of(0, CENTER, cameras=rough))
    late = replace(state_of(0, CENTER), stamp=40_000_000)
    assert np.isin(plain.moving, widened.moving).all()
    assert len(widened.moving) > 1.3 * len(plain.moving)
    assert len(carve(late, speed=2.0).moving) > 1.3 * len(carve(late, speed=0.0).moving)


def test_a_camera_whose_calibration_changes_gets_a_new_table() -> None:
    tables = RigTables(GRID)
    before = tables.of(RIG[0])
    assert tables.of(replace(RIG[0])) is before
    assert tables.of(camera(RIG[0].name, np.array([0.5, 1.9, 1.0]))) is not before
