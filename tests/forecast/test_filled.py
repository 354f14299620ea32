"""Depth that a camera filled in behind somebody frees nothing; light on the ground still hides nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID, RIG, ball_voxels, floor_depth, rays, state_of

from twin_node.forecast.carving import Carver
from twin_node.forecast.tables import RigTables
from twin_node.forecast.verdicts import Carved
from twin_node.scene import Bool, Camera, TwinState

CENTER = np.array([0.0, 0.0, 0.3])
BALL = ball_voxels(CENTER)


def floor_at(cam: Camera) -> np.ndarray:
    """[H, W, 3] where the floor shows in a camera's image, m."""
    return cam.T_base_cam[:3, 3] + rays(cam) * floor_depth(cam)[..., None]


def lit(cam: Camera, radius: float = 0.4) -> Bool:
    """[H, W] a pool of light on the floor."""
    return np.linalg.norm(floor_at(cam)[..., :2] - CENTER[:2], axis=-1) < radius


def shown(masks: tuple[Bool, ...], stamp: int, center: np.ndarray | None = CENTER) -> TwinState:
    """Cameras that measure the floor everywhere, whatever moves before it."""
    state = state_of(stamp, center, with_depth=True)
    views = tuple(replace(view, depth=floor_depth(view.camera)) for view in state.frames.views)
    return replace(state, frames=replace(state.frames, views=views), moving_masks=masks)


def carve(masks: tuple[Bool, ...] | None, **changes: object) -> Carved:
    """What is carved of a bare floor, and then of one that masks show to change."""
    carver = Carver(RigTables(GRID))
    carver.carve(state_of(0, None, with_depth=True), 0.0)
    state = shown(state_of(1, CENTER).moving_masks if masks is None else masks, 1)
    return carver.carve(replace(state, **changes) if changes else state, 0.0)


def test_somebody_whose_depth_was_filled_in_is_held() -> None:
    found = carve(None)

    assert found.may_move.holds(BALL).mean() > 0.98


def test_light_on_the_floor_that_all_cameras_see_change_hides_nothing() -> None:
    found = carve(tuple(map(lit, RIG)))

    assert not (found.may_move | found.unknown).holds(BALL).any()


def test_light_and_somebody_beside_it_are_told_apart() -> None:
    beside = tuple(np.linalg.norm(floor_at(cam)[..., :2] - [0.5, 0.5], axis=-1) < 0.12 for cam in RIG)
    silhouettes = state_of(1, CENTER).moving_masks
    found = carve(tuple(a | b for a, b in zip(beside, silhouettes, strict=True)))

    assert found.may_move.holds(BALL).mean() > 0.98
    above = ball_voxels(np.array([0.5, 0.5, 0.3]), 0.08)
    assert not (found.may_move | found.unknown).holds(above).any()


def test_one_camera_alone_believes_its_depth() -> None:
    carver = Carver(RigTables(GRID))
    state = shown(state_of(1, CENTER).moving_masks, 1)
    first = replace(
        state,
        frames=replace(state.frames, views=state.frames.views[:1]),
        moving_masks=state.moving_masks[:1],
        robot_masks=state.robot_masks[:1],
    )

    assert not carver.carve(first, 0.0).unknown.holds(BALL).any()


def test_a_camera_that_sees_the_arm_there_says_nothing_of_the_floor() -> None:
    arms = (None, *(np.ones((cam.height, cam.width), np.bool_) for cam in RIG[1:]))
    found = carve(None, robot_masks=arms)

    assert not (found.may_move | found.unknown | found.on_arm).holds(BALL).any()


def test_ground_that_something_measured_has_left_is_believed() -> None:
    """Masks hold on to where it was for some images."""
    carver = Carver(RigTables(GRID))
    carver.carve(state_of(0, None, with_depth=True), 0.0)
    there = state_of(1, CENTER, with_depth=True)
    assert carver.carve(there, 0.0).may_move.holds(BALL).all()
    left = carver.carve(shown(there.moving_masks, 2), 0.0)

    assert not (left.may_move | left.unknown).holds(BALL).any()


def test_somebody_whose_depth_is_filled_in_is_held_where_something_measured_was_once() -> None:
    """That the ground is believed holds for as long as what moved there shows, and no longer."""
    carver, empty = Carver(RigTables(GRID)), state_of(0, None, with_depth=True)
    there = state_of(1, CENTER, with_depth=True)
    for state in (empty, there, shown(there.moving_masks, 2), replace(empty, stamp=3)):
        carver.carve(state, 0.0)
    found = carver.carve(shown(there.moving_masks, 4), 0.0)

    assert found.may_move.holds(BALL).mean() > 0.98


def test_ground_that_something_there_from_the_start_has_bared_is_believed() -> None:
    there = state_of(0, CENTER, with_depth=True)
    silhouettes = there.moving_masks
    carver = Carver(RigTables(GRID))
    carver.carve(replace(there, moving_masks=tuple(np.zeros_like(mask) for mask in silhouettes)), 0.0)
    left = carver.carve(shown(silhouettes, 1), 0.0)

    assert not (left.may_move | left.unknown).holds(BALL).any()


def test_what_changes_in_most_of_an_image_is_its_exposure() -> None:
    nothing = tuple(np.zeros_like(mask) for mask in state_of(1, None).moving_masks[1:])
    found = carve((np.ones((RIG[0].height, RIG[0].width), np.bool_), *nothing))
    bare = carve(tuple(np.zeros_like(mask) for mask in state_of(1, None).moving_masks))

    assert np.array_equal(found.unknown.mask(), bare.unknown.mask())


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_depth_filled_in_for_a_part_of_somebody(share: float) -> None:
    """The upper part is measured, the lower one filled."""
    carver = Carver(RigTables(GRID))
    carver.carve(state_of(0, None, with_depth=True), 0.0)
    true = state_of(1, CENTER, 0.2, with_depth=True)
    views = []
    for view in true.frames.views:
        points = view.camera.T_base_cam[:3, 3] + rays(view.camera) * view.depth[..., None]
        low = points[..., 2] < CENTER[2] + (2 * share - 1) * 0.2
        views.append(replace(view, depth=np.where(low, floor_depth(view.camera), view.depth)))
    found = carver.carve(replace(true, frames=replace(true.frames, views=tuple(views))), 0.0)

    assert (found.may_move | found.unknown).holds(ball_voxels(CENTER, 0.2)).mean() > 0.95
